"""A lag under a sampled PI controller with anti-windup; this file builds its FMU and runs it."""

import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, build_native, discrete, every, input, parameter, state


class SampledPI(ModelClass, stop_time=5.0, step_size=0.05):
    """A first-order plant and the PI controller that samples it, whose integral waits while the limit is reached."""

    T = parameter(0.8, "s", "Time constant of the plant", min=1e-6)
    K = parameter(2.0, description="Proportional gain", tunable=True)
    K_i = parameter(1.5, "s-1", "Integral gain", tunable=True)
    limit = parameter(1.5, description="Largest control", min=0.0, tunable=True)
    period = parameter(0.1, "s", "Sampling period", min=1e-6)
    reference = input(1.0, description="Where the plant is to go")
    x = state(0.0, description="Where the plant is")
    integral = discrete(0.0, description="Integral part of the control")
    control = discrete(0.0, description="Control, held until the next sample")

    def derivatives(m):
        return dict(x=(m.control - m.x) / m.T)

    @every(period)
    def sample(m):
        error = m.reference - m.x
        integral = m.integral + m.K_i * m.period * error
        wanted = m.K * error + integral
        control = np.clip(wanted, -m.limit, m.limit)
        return dict(control=control, integral=np.where(control == wanted, integral, m.integral))


if __name__ == "__main__":
    system = System()
    system.add("loop", build_native(SampledPI, "", "fmi2"))
    results = simulate(system, 5.0, 0.05)
    print(f"after 5 s: x = {results['loop.x'][-1]:.4f}; at its limit for {np.sum(results['loop.control'] >= 1.5)} rows")
