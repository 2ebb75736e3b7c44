"""A controller that may use all of Python, here PD with a torque limit; this file builds its FMU.

Then: cosim run --fmu controller=LimitedPD.fmu
"""

from functools import partial

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

INPUTS = ("theta_a", "omega_a", "theta_ref", "omega_ref")


class LimitedPD(Fmi2Slave):
    """tau_a = -K_p (theta_a - theta_ref) - K_d (omega_a - omega_ref), but at most tau_max."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.K_p, self.K_d, self.tau_max = 6.0, 2.0, 0.2  # N.m/rad, N.m.s/rad, N.m
        for name in ("K_p", "K_d", "tau_max"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.u = {f"{name}[{i}]": 0.0 for name in INPUTS for i in (1, 2, 3)}
        for name in self.u:
            get, put = partial(self.u.get, name), partial(self.u.__setitem__, name)
            self.register_variable(Real(name, causality=Fmi2Causality.input, getter=get, setter=put))
        for i in (1, 2, 3):
            # a getter, so that the torque follows the inputs at once and not a step later
            get = partial(self.torque, i)
            self.register_variable(Real(f"tau_a[{i}]", causality=Fmi2Causality.output, getter=get))

    def torque(self, i):
        """Torque of joint i in N.m."""
        theta_a, omega_a, theta_ref, omega_ref = (self.u[f"{name}[{i}]"] for name in INPUTS)
        tau = -self.K_p * (theta_a - theta_ref) - self.K_d * (omega_a - omega_ref)
        return max(-self.tau_max, min(self.tau_max, tau))

    def do_step(self, current_time, step_size):
        """Advance states, of which there are none here; False says that it failed."""
        return True


if __name__ == "__main__":
    from fmu_export import build_script

    print("built", build_script(__file__))
