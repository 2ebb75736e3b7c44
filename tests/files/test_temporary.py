"""Temporary folders: none outlives its process for long, and none of a living one, or of anybody else, is removed."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.files import temporary
from cosim.files.temporary import TemporaryFolder, clear_abandoned

HOLDING = """
import sys
from pathlib import Path
from cosim.files.temporary import TemporaryFolder
with TemporaryFolder("ssp", Path(sys.argv[1])) as folder:
    (Path(folder) / "file").write_text("x")
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    place = tmp_path / "temporary"
    place.mkdir()
    return place


def holding(place: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", HOLDING, place], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def test_a_folder_is_there_as_long_as_its_context(place: Path) -> None:
    with TemporaryFolder("ssp", place) as name:
        folder = Path(name)
        assert folder.parent == place
        assert folder.name.startswith(f"cosim_ssp_pid{os.getpid()}_")
        assert folder.stat().st_mode & 0o77 == 0
        assert list(folder.iterdir()) == []
    assert list(place.iterdir()) == []
    with TemporaryFolder(place=place) as name:
        assert Path(name).name.startswith(f"cosim_pid{os.getpid()}_")


@pytest.mark.skipif(sys.platform == "win32", reason="it has no SIGKILL")
def test_the_next_start_clears_the_folder_of_a_killed_process_and_no_other(place: Path) -> None:
    others = ["cosim_ssp_abcdefgh", "cosim_pid12", "libcosim_pid1_a", "cosim_ssp_pidx_abc", "tmpabcdefgh"]
    for name in others:
        (place / name).mkdir()
    (place / "cosim_ssp_pid1_file").write_text("a file")
    (place / "elsewhere").mkdir()
    (place / "cosim_ssp_pid1_link").symlink_to(place / "elsewhere")
    kept = {*others, "cosim_ssp_pid1_file", "elsewhere", "cosim_ssp_pid1_link"}
    with holding(place) as dies, holding(place) as lives:
        assert dies.stdout is not None
        assert lives.stdout is not None
        dead, alive = (Path(process.stdout.readline().strip()) for process in (dies, lives))
        dies.send_signal(signal.SIGKILL)
        dies.wait()
        assert (dead / "file").exists()
        temporary._cleared.discard(place)
        with TemporaryFolder("fmu", place) as own:
            assert not dead.exists()
            assert (alive / "file").read_text() == "x"
            clear_abandoned(place)  # nor does one that is looked for from within its own process
            assert {path.name for path in place.iterdir()} == {*kept, alive.name, Path(own).name}
        lives.communicate()
    assert {path.name for path in place.iterdir()} == kept


def test_one_that_is_forgotten_goes_with_a_warning(place: Path) -> None:
    folders = [TemporaryFolder("ssp", place)]
    with pytest.warns(ResourceWarning, match="Implicitly cleaning up"):
        folders.clear()
    gc.collect()
    assert list(place.iterdir()) == []


def test_a_file_system_without_locks_has_such_folders_too(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(_handle: int) -> bool:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(temporary, "hold", no_locks)
    with TemporaryFolder("ssp", place) as folder:
        clear_abandoned(place)
        assert Path(folder).is_dir()
    assert list(place.iterdir()) == []
