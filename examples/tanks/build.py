"""Two models in a few lines each; this file builds their FMUs, beside itself.

Then: cosim run tanks.toml
"""

from pathlib import Path

import numpy as np

from fmu_export import ModelClass, build_native, input, output, parameter, state


class Tank(ModelClass, stop_time=60.0, step_size=0.05):
    """Tank with a hole in its floor (Torricelli's law)."""

    A = parameter(0.5, "m2", "Cross section of the tank", min=1e-6)
    a = parameter(0.01, "m2", "Cross section of the hole", min=1e-9)
    inflow = input(0.0, "m3/s", "What flows in")
    level = state(0.2, "m", "Level", min=0.0)
    outflow = output("m3/s", "What flows out")

    def flow(m):
        return m.a * np.sqrt(2.0 * 9.81 * np.maximum(m.level, 1e-9))

    def derivatives(m):
        return dict(level=(m.inflow - m.flow()) / m.A)

    def outputs(m):
        return dict(outflow=m.flow())


class LevelController(ModelClass, stop_time=60.0, step_size=0.05):
    """PI control of a level by a pump that only pumps in."""

    K_p = parameter(0.1, "m2/s", "Proportional gain")
    K_i = parameter(0.01, "m2/s2", "Integral gain")
    q_max = parameter(0.1, "m3/s", "Largest flow of the pump", min=0.0)
    level = input(0.0, "m", "Measured level")
    level_ref = input(0.0, "m", "Desired level")
    z = state(0.0, "m.s", "Integral of the error")
    flow = output("m3/s", "Flow of the pump")

    def derivatives(m):
        return dict(z=m.level_ref - m.level)

    def outputs(m):
        return dict(flow=np.clip(m.K_p * (m.level_ref - m.level) + m.K_i * m.z, 0.0, m.q_max))


if __name__ == "__main__":
    for model in (Tank, LevelController):
        print("built", build_native(model, Path(__file__).parent, "fmi2").name)
