"""Figures of a run, drawn in a process beside it: matplotlib takes longer to import than most runs take."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from cosim.results.output import OutputError

if TYPE_CHECKING:
    from typing import Self

    from cosim.results.results import Results
    from cosim.results.stored import StoredResults

#: What draws any run.
DRAWING = "cosim.results.plot_file:write_plot"

#: A figure shows at most about this many points of a curve; more are not seen and make files large.
_MOST_POINTS = 2000

#: Ctrl-C in a terminal goes to a whole group of processes; what it means for the figures, their parent decides.
_APART: dict[str, Any] = (
    {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)} if os.name == "nt" else {"process_group": 0}
)


class FigureProcess:
    """A process that draws; it ends with the context.

    >>> from cosim import simulate
    >>> with FigureProcess() as figures:
    ...     figures.start()  # it imports matplotlib
    ...     results = simulate(system, stop_time=0.1, step_size=1e-3, record=["plant.x_E", "plant.y_E"])  # meanwhile
    ...     [path.name for path in figures.write("cosim.results.plot_file:write_plot", results, ("a title",), Path())]
    ['results.png']
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def start(self, drawing: str = "") -> None:
        """Start the process, unless it runs; `write` does so too, but then has to wait for it.

        Parameters
        ----------
        drawing : str, optional
            `module:function` that it will be asked for, to import meanwhile.
        """
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, drawing.partition(":")[0]],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
                **_APART,
            )

    def write(
        self, drawing: str, results: Results | StoredResults, arguments: tuple[Any, ...], folder: Path
    ) -> list[Path]:
        """Draw in the process.

        Parameters
        ----------
        drawing : str
            `module:function` that is called with results of as many rows as a figure can show, the arguments and the
            folder; returns the files that it has written. What it raises is raised here.
        results : Results or StoredResults
        arguments : tuple
        folder : Path

        Raises
        ------
        OSError
            A file can't be written.
        OutputError
            The process ended.
        """
        self.start()
        assert self._process is not None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            pickle.dump((drawing, as_drawn(results), *arguments, folder), self._process.stdin)
            self._process.stdin.flush()
            answer = pickle.load(self._process.stdout)
        except (BrokenPipeError, EOFError):
            code = self._process.wait()
            raise OutputError(f"the process that draws figures ended with exit code {code}") from None
        if isinstance(answer, Exception):
            raise answer
        written: list[Path] = answer
        return written


def as_drawn(results: Results | StoredResults) -> Results:
    """As many rows as a figure can show."""
    return results.thinned(max(1, len(results.time) // _MOST_POINTS))


def main() -> None:
    """The process: draw what comes, until nothing more comes."""
    answers, sys.stdout = sys.stdout.buffer, sys.stderr  # nothing else may come between the answers
    for module in ("matplotlib.backends.backend_agg", "cosim.results.results", *filter(None, sys.argv[1:])):
        with suppress(ImportError):  # said when there is something to draw
            import_module(module)  # what takes a while, before there is anything to draw
    while True:
        try:
            drawing, *job = pickle.load(sys.stdin.buffer)
        except (EOFError, pickle.UnpicklingError):  # the program has ended, or was killed as it wrote
            return
        module, _, name = drawing.partition(":")
        try:
            answer: list[Path] | Exception = getattr(import_module(module), name)(*job)
        except Exception as error:
            answer = error
        try:
            pickle.dump(answer, answers)
            answers.flush()
        except BrokenPipeError:
            os._exit(0)  # nobody is there any more; a usual exit would try to write again, and say that it can't


if __name__ == "__main__":
    main()
