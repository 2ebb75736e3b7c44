"""A ball that bounces on the floor, an event; this file builds its FMU and runs it."""

from cosim import System, simulate
from fmu_export import ModelClass, build_native, discrete, parameter, state, when


class BouncingBall(ModelClass, stop_time=3.0, step_size=0.01):
    """A ball on a floor."""

    g = parameter(9.81, "m/s2", "Gravity")
    e = parameter(0.8, description="Speed after a bounce by that before it", min=0.0, max=1.0)
    h = state(1.0, "m", "Height")
    v = state(0.0, "m/s", "Speed, upwards")
    bounces = discrete(0.0, description="Number of bounces")

    def derivatives(m):
        return dict(h=m.v, v=-m.g)

    @when(lambda m: m.h, "falling")
    def bounce(m):
        return dict(h=0.0, v=-m.e * m.v, bounces=m.bounces + 1.0)


if __name__ == "__main__":
    system = System()
    system.add("ball", build_native(BouncingBall, "", "fmi2"))
    results = simulate(system, 3.0, 0.01)
    print(f"{results['ball.bounces'][-1]:g} bounces in 3 s; height {results['ball.h'][-1]:.4f} m")
