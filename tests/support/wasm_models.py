"""Models of which WebAssembly modules are made in tests."""

from __future__ import annotations

import numpy as np

from fmu_export import ModelClass, discrete, every, output, parameter, require, state, when
from fmu_export import input as input_


class Swing(ModelClass, stop_time=2.0, step_size=0.01):
    """A pendulum with friction by a table, pushed by an input, braked by a sampled controller, slowed at the bottom."""

    length = parameter(0.7, "m", "Length", min=0.1, max=2.0)
    g = parameter(9.81, "m/s2")
    grip = parameter(0.3, "1/s", min=0.0, tunable=True)
    push = input_(0.0, "m/s2")
    theta = state(0.5, "rad")
    omega = state(0.0, "rad/s")
    brake = discrete(0.0, "1/s")
    lift = output("m")
    mix = output("1")

    def derivatives(m):
        friction = np.interp(m.omega, [-3.0, -1.0, 0.0, 2.0], [-1.0, -0.6, 0.0, 0.7])
        turn = -m.g / m.length * np.sin(m.theta) - m.grip * friction - m.brake * m.omega + m.push / m.length
        return dict(theta=m.omega, omega=turn)

    def outputs(m):
        mix = np.exp(-(m.omega**2)) + np.arctan(m.theta) ** 3 + np.tanh(m.push) + np.fmod(m.omega, 0.3)
        return dict(lift=m.length * (1.0 - np.cos(m.theta)), mix=mix)

    @every(0.25)
    def braking(m):
        return dict(brake=0.1 * np.abs(m.omega))

    @when(lambda m: m.theta, "falling")
    def bottom(m):
        return dict(omega=0.9 * m.omega)

    @require("the pendulum must not turn over; push less")
    def stays_below(m):
        return 9.0 - m.theta**2


class Typed(ModelClass):
    """Values of all types."""

    n = parameter(3, type="integer", min=1, max=9)
    on = parameter(True, type="boolean")
    speed = parameter("slow", type="enumeration", items=("off", "slow", "fast"))
    text = parameter("b", type="string", items=("a", "b"))
    level = input_(0, type="integer")
    sum = output()

    def outputs(m):
        return dict(sum=m.n + 10.0 * m.on + 100.0 * m.speed + 1000.0 * m.text + 1e4 * m.level)
