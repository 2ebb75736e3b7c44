"""Heat conduction in a rod, by the method of lines; this file builds its FMU and runs it."""

import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, build_native, input, output, parameter, state

#: Number of points inside the rod; another number is another model.
N = 50


class HeatEquation(ModelClass, stop_time=20.0, step_size=0.1):
    """A rod whose ends have given temperatures."""

    length = parameter(1.0, "m", "Length of the rod", min=1e-6)
    diffusivity = parameter(0.01, "m2/s", "Thermal diffusivity", min=0.0)
    T_mean = parameter(300.0, "K", "Temperature of both ends at the start")
    T_rise = parameter(50.0, "K", "How much hotter the middle is at the start")
    T_left = input(300.0, "K", "Temperature of the left end")
    T_right = input(300.0, "K", "Temperature of the right end")
    T = state(300.0, "K", "Temperature at N points, evenly spaced between the ends", size=N)
    T_max = output("K", "Highest temperature inside the rod")

    def initial(m):
        return dict(T=m.T_mean + m.T_rise * np.sin(np.pi * np.arange(1, N + 1) / (N + 1)))

    def derivatives(m):
        spacing = m.length / (N + 1)
        whole = np.concatenate([np.stack([m.T_left]), m.T, np.stack([m.T_right])])
        return dict(T=m.diffusivity * np.diff(whole, 2) / spacing**2)

    def outputs(m):
        return dict(T_max=np.max(m.T))


if __name__ == "__main__":
    system = System()
    system.add("rod", build_native(HeatEquation, "", "fmi2"), start={"T_left": 350.0})
    results = simulate(system, 20.0, 0.1)
    print(f"after 20 s: {results['rod.T'][-1, ::10].round(2)} K")
