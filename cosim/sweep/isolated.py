"""Batches in which workers have died run in a process of their own, so that the deadly point is known for sure.

Dask blames all tasks that a lost worker had at hand. Here a child process runs the points and writes each row when it
has it: the point after the last row is the one that ends the process, and no worker is lost.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from socket import gethostname

from cosim.fmi.unpacking import folder_for_fmus
from cosim.sweep import stock
from cosim.sweep.batch import Batch, Row, Rows
from cosim.sweep.errors import WorkerTrouble
from cosim.sweep.worker import Timer, names_of, rows_of, study_of

#: Beginning of the line that an FMU leaves which ends its process.
_LINE = "cosim: "

#: A point may end this many processes before it counts as failed: something else may have ended one.
_MOST_DEATHS = 2


def run_isolated(batch: Batch) -> Rows:
    """Run all points of a batch in child processes; a point that ends them becomes a row that says so.

    Raises
    ------
    WorkerTrouble
        This worker can't run anything.
    """
    names = names_of(study_of(batch))
    rows: list[Row] = []
    seconds, deaths = 0.0, 0
    while len(rows) < len(batch.indices):
        found, taken, end = _in_a_child(batch.after(len(rows)))
        rows += found
        seconds += taken
        if len(rows) < len(batch.indices):  # it died, whatever its exit code says
            deaths = 1 if found else deaths + 1
            if deaths == _MOST_DEATHS:
                rows.append(Row(batch.indices[len(rows)], None, f"ended the process, {_MOST_DEATHS} times: {end}"))
                deaths = 0
    return Rows.of(names, rows, seconds)


def _in_a_child(batch: Batch) -> tuple[list[Row], float, str]:
    """Rows, what they took (s), and how the child ended."""
    with folder_for_fmus() as name:
        folder = Path(name)
        (folder / "task").write_bytes(pickle.dumps((batch, stock.all_paths())))
        command = [sys.executable, "-m", "cosim.sweep.isolated", name]
        # what the child leaves behind when it dies goes with the folder
        environment = {**os.environ, "TMPDIR": name, "TEMP": name}
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False, env=environment)
        items = _items(folder / "rows")
        for item in items:
            if isinstance(item, WorkerTrouble):
                raise item
        if not items:  # it did not get as far as running anything
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            why = " ".join([_death(done.returncode), *last])
            raise WorkerTrouble(f"{gethostname()}: a child process could not start: {why}")
        rows = [item for item in items if isinstance(item, Row)]
        said = [line for line in done.stderr.decode(errors="replace").splitlines() if line.startswith(_LINE)]
        end = ": ".join([_death(done.returncode), *(line.removeprefix(_LINE) for line in said[-1:])])
        return rows, sum(item for item in items if isinstance(item, float)), end


def _items(path: Path) -> list[object]:
    """Everything that a child wrote before it ended, whole items only."""
    items: list[object] = []
    if path.is_file():
        with path.open("rb") as stream:
            try:
                while True:
                    items.append(pickle.load(stream))
            except (EOFError, pickle.UnpicklingError):
                pass
    return items


def _death(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def main(folder: Path) -> None:
    """The child: run the batch that is in a folder, and write the rows there."""
    batch, paths = pickle.loads((folder / "task").read_bytes())
    stock.know(paths)
    with (folder / "rows").open("wb", buffering=0) as stream:
        try:
            study_of(batch)
            stream.write(pickle.dumps(0.0))
            timer, written = Timer(), 0.0
            for row in rows_of(batch, timer):
                stream.write(pickle.dumps(row) + pickle.dumps(timer.seconds - written))
                written = timer.seconds
        except WorkerTrouble as trouble:
            stream.write(pickle.dumps(trouble))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
