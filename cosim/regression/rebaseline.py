"""Make a reference anew: on purpose only, and only where git has the old one."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from cosim.errors import CosimError
from cosim.files.whole import write_whole
from cosim.fmi.fmu_file import read_fmu
from cosim.regression.case import Case
from cosim.regression.experiment import experiment_of
from cosim.regression.isolated import run_isolated
from cosim.regression.options import write_options
from cosim.regression.run import RunOptions, interfaces_of
from cosim.regression.tolerances import Interface, vector_of
from cosim.results.results import Results

_OPTION = "--fmu-rebaseline"


class RebaselineError(CosimError):
    """A reference must not be made anew here."""


def reason_against(arguments: Sequence[str], environment: Mapping[str, str], *, parallel: bool, fmus: int) -> str:
    """Why references must not be made anew in a session, empty where they may.

    Parameters
    ----------
    arguments : sequence of str
        The command line as it was typed, without options of configuration files and variables.
    environment : mapping
    parallel : bool
        Whether the session has several processes.
    fmus : int
        How many FMUs are selected.
    """
    if not any(argument == _OPTION or argument.startswith(f"{_OPTION}=") for argument in arguments):
        return "must be typed on the command line, not be set elsewhere"
    if environment.get("CI", "").lower() not in ("", "0", "false"):
        return "not in CI (the variable CI is set); make references on your own machine and commit them"
    if parallel:
        return "not in parallel; leave -n away"
    if fmus != 1:
        return f"takes one FMU, not {fmus}; name it with --fmu"
    return ""


def rebaseline(case: Case, path: Path, interface: Interface, timeout: float, *, build: bool = False) -> str:
    """Run an FMU and write what it gives as the reference; options and tolerances only where there are none yet.

    Returns
    -------
    str
        One line that says what was written.

    Raises
    ------
    CosimError
        git could not undo it, or the run fails.
    """
    if case.reference_path.exists() and (why := _not_in_git(case.reference_path)):
        raise RebaselineError(f"{case.reference_path}: {why}; commit it, or move it away to start over")
    as_it_was = dataclasses.replace(case)  # what a case has read it keeps, and its files are written now
    results, _ = run_isolated(as_it_was, path, interface, timeout, options=RunOptions(build))
    fmu = read_fmu(path, str(path))
    experiment = experiment_of(as_it_was, fmu.description)
    case.folder.mkdir(parents=True, exist_ok=True)
    written = [case.reference_path]
    results.save(case.reference_path)
    if not case.options_path.is_file():
        write_options(experiment.options(), case.options_path)
        written.append(case.options_path)
    if not case.tolerances_path.is_file():
        both = len(interfaces_of(fmu)) > 1
        text = _tolerances(results, both=both)
        write_whole(case.tolerances_path, lambda part: part.write_text(text, encoding="utf-8"))
        written.append(case.tolerances_path)
    return f"wrote {', '.join(map(str, written))}: look at the changes, and commit them"


def _not_in_git(path: Path) -> str:
    """Why git could not bring the present content of a file back, empty where it can."""
    commands = (["ls-files", "--error-unmatch"], ["diff", "--quiet", "HEAD"])
    reasons = ("git does not know it", "has changes that are not committed")
    for command, reason in zip(commands, reasons, strict=True):
        try:
            done = subprocess.run(["git", *command, "--", path.name], cwd=path.parent, capture_output=True, check=False)
        except OSError:
            return "there is no git to undo it"
        if done.returncode:
            return reason
    return ""


def _tolerances(results: Results, *, both: bool) -> str:
    """A first file of tolerances, with the units of all signals."""
    lines = [
        "# Largest allowed differences, the larger of two: relative to the range of a signal, absolute in its unit.",
        "relative = 1e-9",
        "absolute = 1e-9",
        "",
        "# a unit that changes is a difference too",
        "[signals]",
    ]
    vectors: dict[str, set[str]] = {}
    units: dict[str, str] = results.info["units"]
    for name, unit in units.items():
        vectors.setdefault(vector_of(name), set()).add(unit)
    for name, found in vectors.items():
        of_all = {name: found.pop()} if len(found) == 1 else {n: u for n, u in units.items() if vector_of(n) == name}
        lines += [f"{_key(one)} = {{ unit = {_quoted(unit)} }}" for one, unit in of_all.items()]
    if both:
        lines += [
            "",
            "# another solver than that inside the co-simulation",
            "[model_exchange]",
            "relative = 1e-4",
            "absolute = 1e-6",
        ]
    return "\n".join(lines) + "\n"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
