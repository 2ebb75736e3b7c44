"""Van der Pol's oscillator with strong damping, which is stiff; this file builds its FMU and runs it."""

from cosim import System, simulate
from fmu_export import ModelClass, build_native, parameter, state


class VanDerPol(ModelClass, stop_time=2000.0, step_size=1.0, solver="rodas4"):
    """An oscillator that creeps for 800 s and then jumps in a few milliseconds."""

    mu = parameter(1000.0, "1", "Damping", min=0.0)
    x = state(2.0, "1", "Position")
    v = state(0.0, "s-1", "Speed")

    def derivatives(m):
        return dict(x=m.v, v=m.mu * (1.0 - m.x**2) * m.v - m.x)


if __name__ == "__main__":
    system = System()
    system.add("oscillator", build_native(VanDerPol, "", "fmi2"))
    results = simulate(system, 2000.0, 1.0)
    jumps = results.time[1:][abs(results["oscillator.x"][1:] - results["oscillator.x"][:-1]) > 1.0]
    print(f"jumps before t = {', '.join(f'{t:.0f} s' for t in jumps)}")
