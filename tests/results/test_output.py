"""The folder of a run: never files of two runs in it, nothing of the user's lost, nothing half written."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from cosim.files.whole import write_json
from cosim.results.output import OutputError, ResultFolder

FIRST = {"results.csv": "time\n1\n", "figures/a.png": "a", "figures/b.png": "b"}
SECOND = {"results.parquet": "PAR1", "figures/b.png": "another b"}


def writing(content: Mapping[str, str]) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        for name, text in content.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        write_json(folder / "summary.json", {"status": "completed", "n": len(content)})

    return write


def run_into(folder: Path, content: Mapping[str, str]) -> None:
    with ResultFolder(folder, [name for name in content if "/" not in name]) as results:
        results.put(writing(content))


def content_of(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): p.read_text() for p in folder.rglob("*") if not p.is_dir()}


def is_whole(folder: Path, content: Mapping[str, str], own: Mapping[str, str] | None = None) -> None:
    """The folder holds one run, and files of the user's own, and nothing else."""
    found = content_of(folder)
    summary = json.loads(found.pop("summary.json"))
    assert found == {**content, **(own or {})}
    assert summary["files"] == {name: hashlib.sha256(text.encode()).hexdigest() for name, text in content.items()}
    assert (summary["status"], summary["n"]) == ("completed", len(content))


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own for temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def test_a_second_run_leaves_nothing_of_the_first_and_all_of_the_user(tmp_path: Path) -> None:
    run_into(tmp_path, FIRST)
    is_whole(tmp_path, FIRST)
    own = {"notes.txt": "mine", "figures/mine.png": "mine", "results.xlsx": "mine"}
    for name, text in own.items():
        (tmp_path / name).write_text(text)
    run_into(tmp_path, SECOND)
    is_whole(tmp_path, SECOND, own)
    run_into(tmp_path, FIRST)
    is_whole(tmp_path, FIRST, own)


def test_folders_that_a_run_leaves_empty_go(tmp_path: Path) -> None:
    run_into(tmp_path, FIRST)
    run_into(tmp_path, {"results.csv": "x"})
    assert not (tmp_path / "figures").exists()


@pytest.mark.parametrize("listed", [True, False])
def test_a_file_of_the_user_in_the_way_is_refused_before_anything_runs(tmp_path: Path, listed: bool) -> None:
    if listed:  # but changed since
        run_into(tmp_path, FIRST)
    (tmp_path / "results.csv").write_text("mine")
    before = content_of(tmp_path)
    with pytest.raises(
        OutputError, match=r"results\.csv is there and belongs to no run.*choose another --out"
    ) as error:
        run_into(tmp_path, FIRST)
    assert "\n" not in str(error.value)
    assert content_of(tmp_path) == before


def test_a_changed_file_that_is_not_in_the_way_stays(tmp_path: Path) -> None:
    run_into(tmp_path, FIRST)
    (tmp_path / "figures/a.png").write_text("retouched")
    run_into(tmp_path, SECOND)
    is_whole(tmp_path, SECOND, {"figures/a.png": "retouched"})


def test_a_file_in_the_way_that_nobody_could_foresee_sends_the_results_elsewhere(
    tmp_path: Path, temporary: Path
) -> None:
    folder = tmp_path / "out"
    run_into(folder, FIRST)
    (folder / "figures/b.png").write_text("mine")
    before = content_of(folder)
    with pytest.raises(OutputError, match=r"b\.png is there and belongs to no run") as error:
        run_into(folder, SECOND)
    assert content_of(folder) == before
    rescue = Path(str(error.value).rpartition("the results are in ")[2])
    assert rescue.parent == temporary
    is_whole(rescue, SECOND)


@pytest.mark.parametrize("text", ["{}", "no JSON", "[1]", '{"name": "summary of another program"}'])
def test_a_summary_of_something_else_is_not_replaced(tmp_path: Path, text: str) -> None:
    (tmp_path / "summary.json").write_text(text)
    with pytest.raises(OutputError, match=r"summary\.json is there and not that of a run"):
        run_into(tmp_path, FIRST)
    assert content_of(tmp_path) == {"summary.json": text}


def test_files_of_version_0_1_0_which_listed_none_are_replaced(tmp_path: Path) -> None:
    write_json(tmp_path / "summary.json", {"status": "completed", "versions": {"python": "3.11"}})
    for name in ("results.csv", "path.png", "notes.txt"):
        (tmp_path / name).write_text("old")
    run_into(tmp_path, {"results.parquet": "PAR1", "path.png": "new"})
    is_whole(tmp_path, {"results.parquet": "PAR1", "path.png": "new"}, {"notes.txt": "old"})


def test_what_is_listed_outside_the_folder_is_left_alone(tmp_path: Path) -> None:
    outside = tmp_path / "mine.txt"
    outside.write_text("mine")
    sha = hashlib.sha256(b"mine").hexdigest()
    folder = tmp_path / "out"
    folder.mkdir()
    names = ("../mine.txt", str(outside), "a/../../mine.txt", "..\\mine.txt")
    write_json(folder / "summary.json", {"files": dict.fromkeys(names, sha)})
    run_into(folder, FIRST)
    is_whole(folder, FIRST)
    assert outside.read_text() == "mine"


def test_a_folder_of_a_sweep_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sweep.json").write_text("{}")
    with pytest.raises(OutputError, match="holds a sweep; choose another --out"):
        run_into(tmp_path, FIRST)


def test_results_that_can_not_be_written_leave_the_earlier_ones(tmp_path: Path, temporary: Path) -> None:
    folder = tmp_path / "out"
    run_into(folder, FIRST)

    def write(where: Path) -> None:
        writing(SECOND)(where)
        if where.is_relative_to(folder):
            raise OSError(28, "No space left on device")

    with (
        pytest.raises(OutputError, match="No space left on device; the results are in") as error,
        ResultFolder(folder) as results,
    ):
        results.put(write)
    is_whole(folder, FIRST)
    is_whole(Path(str(error.value).rpartition("the results are in ")[2]), SECOND)


def test_files_that_grew_during_the_run_are_never_lost(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    run_into(folder, FIRST)

    def refuse(_: Path) -> None:
        raise OSError(28, "No space left on device")

    with ResultFolder(folder) as results:
        (results.unfinished / "results.parquet").write_text("PAR1")
        with pytest.raises(OutputError, match="what was recorded is in") as error:
            results.put(refuse)
    where = Path(str(error.value).rpartition("what was recorded is in ")[2])
    assert content_of(where) == {"results.parquet": "PAR1"}
    assert {name for name in content_of(folder) if not name.startswith(where.name)} == {*FIRST, "summary.json"}


def test_a_run_that_writes_nothing_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    run_into(tmp_path, FIRST)
    with ResultFolder(tmp_path) as results:
        (results.unfinished / "results.parquet").write_text("half")
    is_whole(tmp_path, FIRST)


def test_two_runs_at_once_do_not_share_a_folder(tmp_path: Path) -> None:
    with ResultFolder(tmp_path) as results:
        with pytest.raises(OutputError, match="another run is writing into"):
            run_into(tmp_path, SECOND)
        results.put(writing(FIRST))
    is_whole(tmp_path, FIRST)


KILLED = """
import os, signal, sys
from pathlib import Path
from cosim.results.output import ResultFolder
with ResultFolder(Path(sys.argv[1])) as results:
    (results.unfinished / "results.csv").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_leaves_is_cleared_away(tmp_path: Path) -> None:
    run_into(tmp_path, FIRST)
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert {name for name in content_of(tmp_path) if not name.startswith(".")} == {*FIRST, "summary.json"}
    run_into(tmp_path, SECOND)
    is_whole(tmp_path, SECOND)


#: Makes the second of two runs into one folder each time, and ends it before the n-th change of a name in the folder.
ENDED = """
import json, os, sys
from pathlib import Path
from cosim.results.output import ResultFolder
from cosim.files.whole import write_json

def write(content):
    def into(folder):
        for name, text in content.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        write_json(folder / "summary.json", {"status": "completed", "n": len(content)})
    return into

def ended_before(last, folder):
    def counted(original):
        def change(path, *arguments, **options):
            global changes
            changes += 1
            if changes > last:
                os._exit(1)  # as good as a kill: nothing catches it
            return original(path, *arguments, **options)
        return change

    for name in ("replace", "unlink", "rmdir"):
        setattr(os, name, counted(getattr(os, name)))  # by which pathlib and shutil do it
    with ResultFolder(folder) as results:
        results.put(write(second))

first, second = json.loads(sys.argv[2])
changes = 0
for last in range(60):
    folder = Path(sys.argv[1]) / str(last)
    with ResultFolder(folder) as results:
        results.put(write(first))
    process = os.fork()
    if process == 0:
        ended_before(last, folder)
        os._exit(0)
    if os.waitpid(process, 0)[1] == 0:
        break
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the script forks")
def test_a_kill_while_files_get_their_places_mixes_nothing(tmp_path: Path) -> None:
    """Whatever the number of changes to the folder that came through, the next run finds all files its own."""
    command = [sys.executable, "-c", ENDED, tmp_path, json.dumps([FIRST, SECOND])]
    subprocess.run(command, check=True)
    folders = sorted(tmp_path.iterdir(), key=lambda folder: int(folder.name))
    assert 12 < len(folders) < 60
    seen = set()
    for folder in folders:
        found = {name: text for name, text in content_of(folder).items() if not name.startswith(".")}
        if "summary.json" in found:
            n = json.loads(found["summary.json"])["n"]
            is_whole_but_hidden(folder, FIRST if n == len(FIRST) else SECOND)
            seen.add(n)
        else:  # on its way: each file is that of one run
            assert all(text in (FIRST.get(name), SECOND.get(name)) for name, text in found.items())
            seen.add(0)
        with ResultFolder(folder):  # the next run places what is left, and makes no results of its own
            pass
        is_whole(folder, FIRST if "results.csv" in content_of(folder) else SECOND)
        run_into(folder, SECOND)
        is_whole(folder, SECOND)
        assert [path.name for path in (folder / "figures").iterdir()] == ["b.png"]
    assert seen == {len(FIRST), len(SECOND), 0}


def is_whole_but_hidden(folder: Path, content: Mapping[str, str]) -> None:
    found = {name: text for name, text in content_of(folder).items() if not name.startswith(".unfinished")}
    assert json.loads(found.pop("summary.json"))["files"].keys() == found.keys()
    assert found == content


def test_a_run_that_is_not_whole_stands_beside_one_that_is(tmp_path: Path) -> None:
    def failed(folder: Path) -> None:
        (folder / "results.csv").write_text("until it failed")
        write_json(folder / "summary.json", {"status": "failed"})

    for _ in range(2):  # the second one replaces what the first one has left
        run_into(tmp_path, FIRST)
        for _ in range(2):
            with ResultFolder(tmp_path, ["results.csv"]) as results:
                assert results.holds_whole_run
                results.put(failed, whole=False)
                assert results.killed == []
            found = content_of(tmp_path)
            about = json.loads(found.pop("summary.json.part"))
            assert (found.pop("results.csv.part"), about["status"]) == ("until it failed", "failed")
            assert about["files"] == {"results.csv.part": hashlib.sha256(b"until it failed").hexdigest()}
            is_whole(tmp_path, FIRST, {n: t for n, t in content_of(tmp_path).items() if n.endswith(".part")})
    run_into(tmp_path, SECOND)
    is_whole(tmp_path, SECOND)


def test_a_run_that_is_not_whole_has_a_folder_to_itself(tmp_path: Path) -> None:
    def failed(folder: Path) -> None:
        (folder / "results.csv").write_text("until it failed")
        write_json(folder / "summary.json", {"status": "failed"})

    for _ in range(2):
        with ResultFolder(tmp_path) as results:
            assert not results.holds_whole_run
            results.put(failed, whole=False)
        assert content_of(tmp_path).keys() == {"results.csv", "summary.json"}
    run_into(tmp_path, FIRST)
    is_whole(tmp_path, FIRST)


def test_what_a_killed_run_had_recorded_is_kept_until_it_may_go(tmp_path: Path) -> None:
    run_into(tmp_path, FIRST)
    for number in (1, 2):
        (tmp_path / "results.parquet.part").write_text(f"rows {number}")
        with ResultFolder(tmp_path) as results:
            assert results.killed == [tmp_path / f"killed-{number}-results.parquet.part"]
            assert results.killed[0].read_text() == f"rows {number}"
            results.put(writing(FIRST))
    (tmp_path / "results.parquet.part").write_text("rows")
    with ResultFolder(tmp_path, overwrite=True) as results:
        assert results.killed == []
        results.put(writing(FIRST))
    kept = {f"killed-{number}-results.parquet.part": f"rows {number}" for number in (1, 2)}
    is_whole(tmp_path, FIRST, kept)


def test_files_that_belong_to_no_run_are_replaced_where_that_is_said(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text('{"name": "summary of another program"}')
    (tmp_path / "results.csv").write_text("mine")
    with pytest.raises(OutputError, match="or --overwrite it"):
        run_into(tmp_path, FIRST)
    with ResultFolder(tmp_path, ["results.csv"], overwrite=True) as results:
        results.put(writing(FIRST))
    is_whole(tmp_path, FIRST)


def test_a_file_that_came_into_the_way_of_a_killed_run_stays(tmp_path: Path) -> None:
    command = [sys.executable, "-c", ENDED.replace("range(40)", "[6]"), tmp_path, json.dumps([FIRST, SECOND])]
    subprocess.run(command, check=True)
    folder = tmp_path / "6"
    assert (folder / ".unfinished" / "whole").is_dir()
    (folder / "results.parquet").write_text("mine")
    with ResultFolder(folder) as results:
        (kept,) = results.killed
    assert (folder / "results.parquet").read_text() == "mine"
    assert content_of(kept)["results.parquet"] == SECOND["results.parquet"]


def test_a_full_disk_leaves_what_could_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    run_into(folder, FIRST)

    def write(where: Path) -> None:
        if not where.is_relative_to(folder):
            raise OSError(28, "No space left on device")
        (where / "results.csv.part").write_text("as much as could be")
        raise OSError(28, "No space left on device")

    with ResultFolder(folder) as results, pytest.raises(OutputError, match=r"is in .*out/results\.csv\.part"):
        results.put(write)
    is_whole(folder, FIRST, {"results.csv.part": "as much as could be"})
