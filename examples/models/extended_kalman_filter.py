"""An extended Kalman filter of a pendulum by noisy samples of its place; this file builds its FMU and runs it."""

import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, build_native, discrete, every, input, parameter


class ExtendedKalmanFilter(ModelClass, stop_time=5.0, step_size=0.02):
    """Angle and angular velocity of a pendulum, estimated from noisy samples of l sin(theta)."""

    l = parameter(1.0, "m", "Length of the pendulum", min=1e-6)
    g = parameter(9.81, "m/s2", "Gravity")
    period = parameter(0.02, "s", "Sampling period", min=1e-6)
    q = parameter([1e-6, 1e-4], description="Variances of the process noise, by step")
    r = parameter(1e-2, "m2", "Variance of the measurement noise", min=1e-12)
    measured = input(0.0, "m", "Horizontal place of the pendulum's end")
    theta = discrete(0.3, "rad", "Estimated angle")
    omega = discrete(0.0, "rad/s", "Estimated angular velocity")
    P = discrete([[0.1, 0.0], [0.0, 0.1]], description="Covariance of the estimate")

    @every(period)
    def sample(m):
        # prediction, by a step of the semi-implicit Euler method, and its Jacobian
        omega = m.omega - m.period * m.g / m.l * np.sin(m.theta)
        theta = m.theta + m.period * omega
        slope = -m.period * m.g / m.l * np.cos(m.theta)
        F = np.array([[1.0 + m.period * slope, m.period], [slope, 1.0]])
        P = F @ m.P @ F.T + np.diag(m.q)
        # correction by the measurement
        H = np.stack([m.l * np.cos(theta), 0.0])
        S = H @ P @ H + m.r
        gain = P @ H / S
        x = np.stack([theta, omega]) + gain * (m.measured - m.l * np.sin(theta))
        return dict(theta=x[0], omega=x[1], P=P - np.outer(gain, H) @ P)


if __name__ == "__main__":
    # a pendulum, by small steps, and its measurement with noise
    noise = np.random.default_rng(1).normal(0.0, 0.1, 251)
    theta, omega, truth = 0.5, 0.0, []
    for _ in noise:
        truth.append(theta)
        for _ in range(100):
            omega -= 2e-4 * 9.81 * np.sin(theta)
            theta += 2e-4 * omega
    system = System()
    system.add("filter", build_native(ExtendedKalmanFilter, "", "fmi2"))
    system.drive("filter.measured", lambda t: np.sin(truth[round(t / 0.02)]) + noise[round(t / 0.02)])
    error = simulate(system, 5.0, 0.02)["filter.theta"] - truth
    print(f"error of the angle in the last second: {np.sqrt(np.mean(error[-50:] ** 2)):.3f} rad; noise: 0.1 m")
