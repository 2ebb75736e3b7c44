"""A chain of point masses on massless rods, with a torque at the first joint; this file builds its FMU and runs it."""

import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, build_native, input, output, parameter, state

#: Number of links; another number is another model.
N = 3
#: Of each two rods the lower one.
LOWER = np.maximum.outer(np.arange(N), np.arange(N))


class NLinkPendulum(ModelClass, stop_time=5.0, step_size=0.01):
    """N point masses on rods, one hanging from the other."""

    m_i = parameter(np.full(N, 0.5), "kg", "Mass at the end of each rod", min=1e-6)
    l = parameter(np.full(N, 0.3), "m", "Length of each rod", min=1e-6)
    g = parameter(9.81, "m/s2", "Gravity", tunable=True)
    d = parameter(0.0, "N.m.s/rad", "Friction in each joint", min=0.0, tunable=True)
    theta = state(np.linspace(1.0, 1.5, N), "rad", "Angle of each rod from the vertical")
    omega = state(np.zeros(N), "rad/s", "Angular velocity of each rod")
    tau = input(0.0, "N.m", "Torque on the first rod")
    energy = output("J", "Kinetic and potential energy")

    def mass_below(m):
        """Mass (N,) that each rod carries."""
        return np.cumsum(m.m_i[::-1])[::-1]

    def inertia(m):
        """Inertia (N, N) that each two rods share: that of the masses below the lower one."""
        return m.mass_below()[LOWER] * np.outer(m.l, m.l)

    def mass_matrix(m):
        return m.inertia() * np.cos(m.theta[:, None] - m.theta)

    def derivatives(m):
        centrifugal = (m.inertia() * np.sin(m.theta[:, None] - m.theta)) @ m.omega**2
        gravity = m.mass_below() * m.g * m.l * np.sin(m.theta)
        relative = m.omega - np.concatenate([np.zeros(1), m.omega[:-1]])
        friction = m.d * (relative - np.concatenate([relative[1:], np.zeros(1)]))
        torque = np.concatenate([np.stack([m.tau]), np.zeros(N - 1)])
        return dict(theta=m.omega, omega=np.linalg.solve(m.mass_matrix(), torque - centrifugal - gravity - friction))

    def outputs(m):
        kinetic = 0.5 * m.omega @ m.mass_matrix() @ m.omega
        return dict(energy=kinetic - m.g * m.mass_below() @ (m.l * np.cos(m.theta)))


if __name__ == "__main__":
    system = System()
    system.add("pendulum", build_native(NLinkPendulum, "", "fmi2"))
    results = simulate(system, 5.0, 0.01)
    energy = results["pendulum.energy"]
    print(f"angles after 5 s: {results['pendulum.theta'][-1]} rad; energy kept to {np.ptp(energy):.1e} J")
