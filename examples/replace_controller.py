"""A controller of your own, here PID on each active joint; this file builds its FMU.

Then: cosim run --fmu controller=PID.fmu
"""

from fmu_export import ModelClass, build_native, input, output, parameter, state


class PID(ModelClass, stop_time=15.0, step_size=1e-3):
    """PID control of each active joint."""

    K_p = parameter(6.0, "N.m/rad", "Proportional gain", tunable=True)
    K_i = parameter(12.0, "N.m/(rad.s)", "Integral gain", tunable=True)
    K_d = parameter(2.0, "N.m.s/rad", "Derivative gain", tunable=True)
    theta_a = input(0.0, "rad", "Measured angle of the active links", size=3)
    omega_a = input(0.0, "rad/s", "Measured angular velocity of the active links", size=3)
    theta_ref = input(0.0, "rad", "Desired angle of the active links", size=3)
    omega_ref = input(0.0, "rad/s", "Desired angular velocity of the active links", size=3)
    z = state(0.0, "rad.s", "Integral of the angle error", size=3)
    tau_a = output("N.m", "Torque on the active joints", size=3)

    def derivatives(m):
        """Time derivative of the state."""
        return dict(z=m.theta_a - m.theta_ref)

    def outputs(m):
        """Torque."""
        return dict(tau_a=-m.K_p * (m.theta_a - m.theta_ref) - m.K_i * m.z - m.K_d * (m.omega_a - m.omega_ref))


if __name__ == "__main__":
    print("built", build_native(PID, "", "fmi2"))
