"""The table of formats: one entry is a format everywhere; the MAT files are those that SciPy writes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from cosim import Results, StoredResults, TableWriter
from cosim.results.formats import FORMATS, endings, format_of

ROOT = Path(__file__).resolve().parents[2]

#: A process in which the table has one more entry, before anything else is imported.
ONE_MORE = """
import runpy, sys
from pathlib import Path

import cosim.results.formats as formats

def write(table, path):
    path.write_text(" ".join(table.names))

formats.FORMATS["names"] = formats.Format("names", "people who only want names", write)

import numpy as np

from cosim import CosimError, Results, StoredResults, TableWriter
from cosim.__main__ import command_line, main

results = Results(np.zeros(1), ["a.x", "b.y"], np.zeros((1, 2)))
results.save("r.names")
assert Path("r.names").read_text() == "a.x b.y"
results.save("r.parquet")
StoredResults(Path("r.parquet"), {}).save("s.names")
assert Path("s.names").read_text() == "a.x b.y"
for documented in (Results, StoredResults):
    assert " or .names" in documented.save.__doc__, documented.save.__doc__
assert "names" not in TableWriter.__doc__.partition("Parameters")[0]
for path in ("r.xls", "r.names"):
    try:
        results.save(path) if path == "r.xls" else TableWriter([Path(path)], ["a"])
    except CosimError as error:
        print(error)
help_of_run = next(a for a in command_line()._actions if a.choices).choices["run"].format_help()
assert ",names" in "".join(help_of_run.split()), help_of_run
assert "people who only want names" in " ".join(help_of_run.split()), help_of_run
assert "| `.names` | people who only want names | no |" in formats.markdown_table()
configuration = runpy.run_path(sys.argv[1])
assert "people who only want names" in configuration["myst_substitutions"]["formats"]
"""


def run(code: str, folder: Path, *arguments: str | Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_one_entry_makes_a_format_everywhere(tmp_path: Path) -> None:
    """Files in memory and stored, docstrings, messages, the option of the command line, the documentation."""
    lines = run(ONE_MORE, tmp_path, ROOT / "docs/conf.py").splitlines()
    assert lines == [
        f"r.xls: unknown format '.xls'; use {endings().replace(' or ', ', ')} or .names",
        "r.names: can't be written as it grows; use .csv or .parquet",
    ]
    assert "{{ formats }}" in (ROOT / "docs/results.md").read_text(encoding="utf-8")


def test_reading_the_table_imports_no_large_package(tmp_path: Path) -> None:
    code = "import cosim.results.formats, sys; print({'numpy', 'pyarrow', 'fmpy', 'scipy'} & set(sys.modules))"
    assert run(code, tmp_path) == "set()\n"


def test_the_default_is_csv_and_long_runs_have_a_format() -> None:
    assert next(iter(FORMATS)) == "csv"
    assert endings(streamed=True) == ".csv or .parquet"
    assert [format_of(Path(f"x.{name}")).name for name in FORMATS] == list(FORMATS)
    for documented in (Results.save, StoredResults.save, TableWriter):
        assert "{" not in (documented.__doc__ or "{")


def test_mat_files_have_the_bytes_that_scipy_writes(tmp_path: Path) -> None:
    time = 0.1 * np.arange(5)
    names, units = ["plant.x", "plant.theta[1]", "u"], {"plant.x": "m", "plant.theta[1]": "rad/s"}
    values = np.column_stack([np.sin(time), -time, time**2])
    Results(time, names, values, {"units": units}).save(tmp_path / "ours.mat")

    def characters(texts: list[str]) -> np.ndarray:
        width = max(map(len, texts))
        return np.ascontiguousarray(np.array([list(text.ljust(width)) for text in texts]).T)

    expected = {
        "Aclass": np.array(["Atrajectory", "1.1", "", "binTrans"]),
        "name": characters(["time", *names]),
        "description": characters(["Time in [s]", "[m]", "[rad/s]", ""]),
        "dataInfo": np.array([[0, 2, 2, 2], [1, 2, 3, 4], [0] * 4, [-1] * 4], dtype=np.int32),
        "data_1": np.array([[time[0], time[-1]]]),
        "data_2": np.vstack([time, values.T]),
    }
    savemat(tmp_path / "scipy.mat", expected, format="4", appendmat=False)
    assert (tmp_path / "ours.mat").read_bytes() == (tmp_path / "scipy.mat").read_bytes()


def test_mat_files_take_units_beyond_ascii(tmp_path: Path) -> None:
    results = Results(np.zeros(2), ["oven.T"], np.ones((2, 1)), {"units": {"oven.T": "°C"}})
    results.save(tmp_path / "r.mat")
    data = loadmat(tmp_path / "r.mat", chars_as_strings=False)
    assert (data["data_2"][1] == 1.0).all()
    assert "".join(data["name"].T[1]).rstrip() == "oven.T"


def test_a_run_without_rows_or_columns_has_a_mat_file(tmp_path: Path) -> None:
    Results(np.empty(0), [], np.empty((0, 0))).save(tmp_path / "r.mat")
    assert loadmat(tmp_path / "r.mat")["data_2"].shape == (1, 0)
