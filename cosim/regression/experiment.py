"""When an FMU is run for a case: from when to when, at which step, and which rows are kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from fmpy.model_description import ModelDescription

from cosim.regression.case import Case, CaseError
from cosim.regression.options import Options

#: Rows where nothing says how many.
_ROWS = 500

#: Solver tolerance where nothing says which.
_SOLVER_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Experiment:
    """Start, stop and communication step (s), every how many-th step makes a row, and the relative tolerance.

    `tolerance` is that of the case, None where it says none and the FMU's own holds.
    """

    start_time: float
    stop_time: float
    step_size: float
    every: int
    solver_tolerance: float
    tolerance: float | None = None

    @property
    def interval(self) -> float:
        """Time between two rows (s)."""
        return self.step_size * self.every

    def options(self) -> Options:
        """The same for `<case>_ref.opt`."""
        return Options(self.start_time, self.stop_time, self.step_size, self.solver_tolerance, self.interval)


def experiment_of(case: Case, description: ModelDescription) -> Experiment:
    """Experiment by the options of a case; then by its reference, its inputs, and the default experiment of the FMU.

    Raises
    ------
    CosimError
        A file of the case can't be read, nothing says when to stop, or the rows are not a whole number of steps apart.
    """
    options = case.options()
    reference = case.reference() if case.reference_path.is_file() else None
    inputs = case.inputs()
    default = description.defaultExperiment
    times = [table.time for table in (reference, inputs) if table is not None and len(table.time) > 1]
    if options is not None:
        start, stop = options.start_time, options.stop_time
    elif times:
        start, stop = times[0][0].item(), times[0][-1].item()
    elif default is not None and default.stopTime is not None:
        start, stop = float(default.startTime or 0.0), float(default.stopTime)
    else:
        raise CaseError(f"case '{case.name}': nothing says when to stop; write {case.options_path} with its StopTime")
    tolerance = (options and options.relative_tolerance) or float(getattr(default, "tolerance", None) or 0.0)
    rows = _spacing(times[0]) if reference is not None and times else (options and options.output_interval)
    step = (
        (options and options.step_size)
        or rows
        or next(filter(None, map(_spacing, times)), None)
        or float(getattr(default, "stepSize", None) or 0.0)
        or (stop - start) / _ROWS
    )
    exact = (rows or step) / step
    every = max(1, round(exact))
    if abs(exact - every) > 1e-6:
        raise CaseError(
            f"case '{case.name}': rows {rows:.9g} s apart are not a whole number of steps of {step:.9g} s; "
            f"change StepSize in {case.options_path}"
        )
    own = options.relative_tolerance if options is not None and options.relative_tolerance else None
    return Experiment(start, stop, step, every, tolerance or _SOLVER_TOLERANCE, own)


def _spacing(times: np.ndarray) -> float | None:
    """Time between two rows (s), None where it differs."""
    spacing = (times[-1] - times[0]) / (len(times) - 1)
    # as written, rows have some digits only
    even = spacing > 0.0 and np.allclose(np.diff(times), spacing, rtol=1e-6, atol=1e-9 * np.abs(times).max())
    if not even:
        return None
    # 0.01 rather than 0.009999999999999998
    return float(f"{spacing:.12g}")
