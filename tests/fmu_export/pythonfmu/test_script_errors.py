"""A script that raises, wherever it does: the importer gets an error with the last line of the traceback, and lives."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.bare_host import fresh
from tests.support.scripts import scripted, slave

LIVES = """
import gc
gc.collect()
for host in hosts:
    host.free()
del hosts
gc.collect()
"""


@pytest.mark.parametrize("place", ["do_step", "exit_initialization_mode", "terminate", "getter", "log"])
def test_an_exception_is_an_error_with_the_last_line_of_its_traceback(place: str, tmp_path: Path) -> None:
    """Ten times, for what the binary frees once too often crashes the host later."""
    script = slave("self.ready = True\nif broken.step: broken.fail()", "import broken") + (
        "    def exit_initialization_mode(self):\n        if broken.leave: broken.fail()\n\n"
        "    def terminate(self):\n        if broken.end: broken.fail()\n\n"
        "    @property\n    def y(self):\n"
        "        return broken.fail() if broken.get and 'ready' in vars(self) else 1.0\n\n"
        "    @y.setter\n    def y(self, value):\n        pass\n"
    )
    flags = {"do_step": "step", "exit_initialization_mode": "leave", "terminate": "end", "getter": "get", "log": "step"}
    flag = flags[place]
    broken = "".join(f"{name} = {name == flag}\n" for name in ("step", "leave", "end", "get"))
    broken += "\ndef fail():\n    raise RuntimeError('the motor is at 50% load')\n"
    if place == "log":
        script = script.replace("if broken.step:", "self.log('first 100%')\n        if broken.step:")
    fmu = scripted(tmp_path / "fmu", script, {"broken.py": broken})
    run = (
        """
hosts, said = [], []
for _ in range(10):
    host = Host(A.fmu)
    hosts.append(host)
    status = max(host.initialize(), host.step(0.0, 0.1), host.call("Terminate"))
    try:
        host.get()
    except AssertionError as error:
        status, _ = 4, said.append(str(error))
    said.append(host.said())
    assert status == 4
report(said)
"""
        + LIVES
    )
    said = fresh(tmp_path, run, fmu=fmu)
    assert len([s for s in said if "RuntimeError: the motor is at 50%% load (broken.py, line 7, in fail)" in s]) == 10
    if place == "log":
        assert all("first 100%%" in text for text in said if text)


def test_messages_with_percent_signs_reach_the_log_of_the_host(tmp_path: Path) -> None:
    fmu = scripted(tmp_path / "fmu", slave("self.log('100% of it'); self.log('%n'); self.y = 1.0"))
    run = """
host = Host(A.fmu)
assert host.initialize() == 0 and host.step(0.0, 0.1) == 0
report(host.said())
"""
    assert fresh(tmp_path, run, fmu=fmu) == "100%% of it\n%%n"


def test_an_instance_that_cannot_be_made_says_why(tmp_path: Path) -> None:
    init = "import pathlib, re\nself.k = float(pathlib.Path(self.resources, 'k.txt').read_text())"
    fmu = scripted(tmp_path / "fmu", slave("self.y = self.k", init=init), {"k.txt": "2.0"})
    run = """
import zipfile
with zipfile.ZipFile(A.fmu) as archive:
    archive.extractall("unpacked")
path = os.path.join("unpacked", "resources", "k.txt")
said = []
class Quiet(Host):
    def _log(self, status, category, message):
        said.append(message.decode())
before = list(sys.path)
os.rename(path, "k.txt")
for _ in range(5):
    try:
        Quiet(None, folder="unpacked")
    except RuntimeError:
        pass
    assert sys.path == before
assert len(said) == 5
os.rename("k.txt", path)
host = Host(None, folder="unpacked")
assert host.initialize() == 0 and host.step(0.0, 0.1) == 0
os.rename(path, "k.txt")
assert host.reset() == 0  # an error here would crash the host; it comes at the next call
assert host.initialize() > 2
said.append(host.said())
os.rename("k.txt", path)
assert host.reset() == 0 and host.initialize() == 0 and host.step(0.0, 0.1) == 0
assert host.get() == [2.0]
host.free()
report(said)
"""
    said = fresh(tmp_path, run, fmu=fmu)
    assert len(said) == 6
    for text in said:
        assert "FileNotFoundError" in text
        assert "(script.py, line 13, in __init__)" in text


def test_a_step_that_returns_nothing_is_an_error(tmp_path: Path) -> None:
    """Pythonfmu takes None for False, which means that the simulation ends."""
    fmu = scripted(tmp_path / "fmu", slave("self.y = 1.0").replace("return True", "return None"))
    run = """
host = Host(A.fmu)
assert host.initialize() == 0
assert host.step(0.0, 0.1) > 2
report(host.said())
"""
    assert "do_step returned None; it must return True" in fresh(tmp_path, run, fmu=fmu)


def test_a_step_that_returns_false_is_discarded(tmp_path: Path) -> None:
    fmu = scripted(tmp_path / "fmu", slave("self.y = 1.0").replace("return True", "return False"))
    assert fresh(tmp_path, "h = Host(A.fmu); h.initialize(); report(h.step(0.0, 0.1))", fmu=fmu) == 2
