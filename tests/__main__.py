"""The checks that must pass: style, types, tests.

`python -m tests` leaves out the tests that are marked slow; `--all` runs them too. `--fast` runs a choice in less
than a minute; `--coverage` measures which lines are run.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys

#: Each process leaves a file.
REPORT_OF_COVERAGE = (("coverage", "combine", "--quiet"), ("coverage", "report"))

STYLE_AND_TYPES = (("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",))

#: By file: the tests of a file share FMUs and runs.
IN_PARALLEL = ("-n", "2", "--dist", "loadfile")

#: The units of every room: those that a change of code most often fails.
FAST = (
    *("models", "fmu_export/modelling", "fmu_export/trace"),
    *("fmi", "system", "master", "loop", "results", "scenario", "ssp"),
    *("analysis", "sweep/test_points.py", "sweep/test_store.py", "commands/test_validate_command.py"),
    *("regression/test_compare.py", "regression/test_funnel.py", "regression/test_case.py"),
    *("house/test_architecture.py", "house/test_tests.py", "parallel_robot/test_metrics.py"),
)

#: But not those that compile much or start many processes.
NOT_FAST = (
    *("fmi/test_python_fmus.py", "fmi/test_messages.py", "fmi/test_loading.py", "fmi/test_process.py"),
    *("fmi/test_isolation.py", "fmi/test_placement.py", "fmi/test_ended_process.py"),
    *("loop/test_source.py", "loop/test_team.py", "master/test_checkpoint.py", "master/test_failures.py"),
    *("master/test_simulation.py", "master/test_quirky_fmus.py", "master/test_model_exchange.py"),
    *("master/test_polynomials.py", "master/test_coupling.py", "master/test_starting_blocks.py"),
    *("master/test_iterated_steps.py", "master/test_variable_steps.py", "master/test_component_times.py"),
    *("results/test_figure_process.py", "results/test_page.py", "ssp/test_writing.py", "ssp/test_guests.py"),
    *("fmu_export/trace/test_idioms.py",),
)


def fast() -> tuple[str, ...]:
    """What pytest takes to run the units of every room only."""
    return (*(f"tests/{name}" for name in FAST), *(f"--ignore=tests/{name}" for name in NOT_FAST))


def tests(options: argparse.Namespace) -> tuple[str, ...]:
    """The command of the tests, as of `python -m`."""
    command = ("pytest", *IN_PARALLEL, *(fast() if options.fast else ()), *(("-m", "") if options.all else ()))
    # coverage starts pytest, not the other way round: the import of the regression's plugin counts too
    return ("coverage", "run", "-m", *command) if options.coverage else command


def main() -> int:
    """Run all checks, and fail if any failed."""
    parser = argparse.ArgumentParser(prog="python -m tests", description=__doc__)
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument("--all", action="store_true", help="run the slow tests too")
    extent.add_argument("--fast", action="store_true", help="run a choice of tests, in less than a minute")
    parser.add_argument("--coverage", action="store_true", help="measure coverage; takes a third longer")
    options = parser.parse_args()
    # tests start hundreds of interpreters: without byte code, each compiles the packages anew
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    failed = []
    for command in (*STYLE_AND_TYPES, tests(options), *(REPORT_OF_COVERAGE if options.coverage else ())):
        print("$", *(word or "''" for word in command), flush=True)
        if subprocess.run([sys.executable, "-m", *command], check=False, env=environment).returncode:
            failed.append(command[0])
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"CPU: {used.ru_utime + used.ru_stime:.0f} s")
    if failed:
        print("failed:", *failed)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
