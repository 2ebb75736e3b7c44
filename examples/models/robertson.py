"""Robertson's reaction, with rates from 0.04 to 3e7; this file builds its FMU and runs it."""

from cosim import System, simulate
from fmu_export import ModelClass, build_native, parameter, state


class Robertson(ModelClass, stop_time=40.0, step_size=40.0, solver="rodas4"):
    """Three substances of an autocatalytic reaction (H. H. Robertson, 1966)."""

    k_1 = parameter(0.04, "s-1", "Rate of A -> B", min=0.0)
    k_2 = parameter(3e7, "s-1", "Rate of B + B -> B + C", min=0.0)
    k_3 = parameter(1e4, "s-1", "Rate of B + C -> A + C", min=0.0)
    A = state(1.0, "1", "Part of A", min=0.0)
    B = state(0.0, "1", "Part of B, which is very reactive", nominal=1e-5)
    C = state(0.0, "1", "Part of C")

    def derivatives(m):
        slow, fastest, fast = m.k_1 * m.A, m.k_2 * m.B**2, m.k_3 * m.B * m.C
        return dict(A=fast - slow, B=slow - fast - fastest, C=fastest)


if __name__ == "__main__":
    system = System()
    system.add("reaction", build_native(Robertson, "", "fmi2"))
    results = simulate(system, 40.0, 40.0)
    print(f"after one step of 40 s: {[float(results[f'reaction.{n}'][-1]) for n in 'ABC']}")
