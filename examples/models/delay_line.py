"""A signal that comes out later, sampled into a line of values; this file builds its FMU and runs it."""

import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, build_native, discrete, every, input, output, parameter

#: Number of samples in the line; another number is another model.
N = 20


class DelayLine(ModelClass, stop_time=5.0, step_size=0.05):
    """A line that N samples go through."""

    period = parameter(0.05, "s", "Sampling period: the delay is N times as long", min=1e-6)
    u_0 = parameter(0.0, description="What comes out before the first sample does")
    u = input(0.0, description="Signal")
    line = discrete(0.0, description="Samples, the newest first", size=N, output=False)
    y = output(description="Delayed signal")

    def initial(m):
        return dict(line=np.full(N, m.u_0))

    def outputs(m):
        return dict(y=m.line[-1])

    @every(period)
    def shift(m):
        return dict(line=np.concatenate([np.stack([m.u]), m.line[:-1]]))


if __name__ == "__main__":
    system = System()
    system.add("line", build_native(DelayLine, "", "fmi2"))
    system.drive("line.u", np.sin)
    results = simulate(system, 5.0, 0.05)
    print(f"sin(5) = {np.sin(5.0):.4f}; what comes out at 5 s: {results['line.y'][-1]:.4f}")
