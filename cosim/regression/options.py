"""`<case>_ref.opt`: start, stop, step and solver tolerance of a reference, as the FMI cross-check has them.

The format is that of the FMI Cross-Check Rules 4.1, section 9.1.4: a line `Key, value` each, with comments after `//`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import CosimError
from cosim.files.whole import write_whole

#: Key of the file -> attribute. Further keys that the rules allow say nothing that is needed here.
_KEYS = {
    "StartTime": "start_time",
    "StopTime": "stop_time",
    "StepSize": "step_size",
    "RelTol": "relative_tolerance",
    "OutputIntervalLength": "output_interval",
}


class OptionsError(CosimError):
    """A file of options is malformed."""


@dataclass(frozen=True)
class Options:
    """Options that a reference was made with.

    Attributes
    ----------
    start_time, stop_time : float
        In s.
    step_size : float
        Communication step (s); 0 for a solver with variable step.
    relative_tolerance : float, optional
        Of the solver.
    output_interval : float, optional
        Time between two rows of the reference (s).
    """

    start_time: float
    stop_time: float
    step_size: float = 0.0
    relative_tolerance: float | None = None
    output_interval: float | None = None


def read_options(path: Path) -> Options:
    """Read a file of options.

    Raises
    ------
    OptionsError
        The file can't be read, a number is none, or the start or stop time is missing; the message names the line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise OptionsError(f"{path}: can't be read: {error}") from error
    found: dict[str, float] = {}
    for number, line in enumerate(lines, start=1):
        key, _, rest = line.partition("//")[0].partition(",")
        attribute, text = _KEYS.get(key.strip()), rest.strip()
        if attribute is None or (not text and attribute == "output_interval"):  # the rules' example leaves it empty
            continue
        try:
            found[attribute] = float(text)
        except ValueError:
            raise OptionsError(f"{path}: line {number}: {key.strip()} = {text!r} must be a number") from None
        if not math.isfinite(found[attribute]) or (found[attribute] < 0.0 and attribute != "start_time"):
            raise OptionsError(f"{path}: line {number}: {key.strip()} = {text} must be finite and not negative")
    for key in ("StartTime", "StopTime"):
        if _KEYS[key] not in found:
            raise OptionsError(f"{path}: {key} is missing; add a line '{key}, <seconds>'")
    return Options(**found)


def write_options(options: Options, path: Path) -> None:
    """Write a file of options.

    Raises
    ------
    OSError
        It can't be written.
    """
    values = {key: getattr(options, attribute) for key, attribute in _KEYS.items()}
    lines = [f"{key}, {value!r}\n" for key, value in values.items() if value is not None]
    write_whole(path, lambda part: part.write_text("".join(lines), encoding="utf-8"))
