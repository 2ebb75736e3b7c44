"""A run in a process of its own, which an FMU may crash or block without harm to the other cases."""

from __future__ import annotations

import logging
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from cosim.errors import CosimError
from cosim.regression.case import Case, Method, RunError
from cosim.regression.run import RunOptions, run
from cosim.regression.tolerances import Interface
from cosim.results.results import Results

#: So much of what an FMU prints is kept (characters).
_MOST_OUTPUT = 10_000


def run_isolated(
    case: Case,
    path: Path,
    interface: Interface,
    timeout: float,
    method: Method = "CVode",
    options: RunOptions = RunOptions(),  # noqa: B008 (frozen)
) -> tuple[Results, str]:
    """The same as `run`, in a child process; also what it printed.

    Raises
    ------
    RunError
        The run failed, ended its process, or took longer than `timeout` (s).
    """
    with TemporaryDirectory(prefix="cosim_", ignore_cleanup_errors=True) as name:
        answer = Path(name) / "answer"
        (Path(name) / "task").write_bytes(pickle.dumps((case, path, interface, method, options)))
        command = [sys.executable, "-m", "cosim.regression.isolated", name]
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                check=False,
                timeout=timeout,
            )
        except subprocess.TimeoutExpired:
            raise RunError(f"{path}: did not end within {timeout:g} s; allow more with --fmu-timeout") from None
        said = done.stdout.decode(errors="replace").strip()[-_MOST_OUTPUT:]
        if not answer.is_file():
            last = said.splitlines()[-1:]
            raise RunError(": ".join([f"{path}: ended its process ({_death(done.returncode)})", *last]))
        results = pickle.loads(answer.read_bytes())
    if isinstance(results, str):
        raise RunError(results)
    return results, said


def _death(code: int) -> str:
    if code < 0 and -code in set(signal.Signals):
        return signal.Signals(-code).name
    return f"exit code {code}"


def main(folder: Path) -> None:
    """The child: run what is in a folder, and put the results there, or the one line that says why there are none."""
    case, path, interface, method, options = pickle.loads((folder / "task").read_bytes())
    if options.log is not None:
        logging.basicConfig(stream=sys.stdout, level=logging.INFO, format="%(message)s")
    try:
        answer: Results | str = run(case, path, interface, method, options)
    except CosimError as error:
        answer = str(error)
    (folder / "unfinished").write_bytes(pickle.dumps(answer))
    (folder / "unfinished").replace(folder / "answer")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
