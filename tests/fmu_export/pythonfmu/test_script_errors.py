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


def test_calls_out_of_order_are_refused_and_after_one_only_a_reset_or_a_restored_state_helps(tmp_path: Path) -> None:
    """In every phase what the standard's table does not allow there; the script is not called."""
    fmu = scripted(tmp_path / "fmu", slave("self.y += 1.0"))
    run = """
ways = {
    "new": [], "set up": ["setup"], "initialising": ["setup", "enter"], "stepping": ["setup", "enter", "leave"],
    "terminated": ["setup", "enter", "leave", "terminate"],
}
wrong = {
    "new": ["enter", "leave", "step", "terminate", "get"],
    "set up": ["leave", "step", "terminate", "get"],
    "initialising": ["setup", "enter", "step", "terminate"],
    "stepping": ["setup", "enter", "leave", "jump", "back", "past"],
    "terminated": ["setup", "enter", "leave", "step", "terminate", "set"],
}
host = Host(A.fmu)
values = (ctypes.c_double * 1)()
calls = {
    "setup": lambda: host.call("SetupExperiment", 0, 0.0, 0.5, 1, 0.7), "enter": host.enter, "leave": host.leave,
    "step": lambda: host.step(0.5, 0.1), "jump": lambda: host.step(0.6, 0.1), "back": lambda: host.step(0.4, 0.1),
    "past": lambda: host.step(0.5, 0.3), "terminate": lambda: host.call("Terminate"),
    "set": lambda: host.set({"y": 1.0}), "get": lambda: host.call("GetReal", host._references(["y"]), 1, values),
}
texts = {}
for phase, way in ways.items():
    for name in wrong[phase]:
        assert host.reset() == 0
        for step in way:
            assert calls[step]() == 0, (phase, step, host.said())
        kept = host.save()
        assert calls[name]() == 4, (phase, name)
        texts[f"{phase}: {name}"] = host.said()
        for other in ("setup", "enter", "leave", "step", "terminate", "set"):
            assert calls[other]() == 4, (phase, name, other)
            assert "after an error; restore a saved FMU state, or reset" in host.said()
        assert calls["get"]() == 0  # after an error values can be looked at
        data = host.to_bytes(kept)
        for state in (kept, host.from_bytes(data)[1]):
            assert host.restore(state) == 0 and host.drop(state) == 0, host.said()
            assert calls[name]() == 4
            assert host.said() == texts[f"{phase}: {name}"]
assert host.reset() == 0 and host.initialize() == 0
host.run(2)
assert host.get() == [2.0]
damaged = host.from_bytes(b"STEP nonsense 1\\nrest")[1]
assert host.restore(damaged) == 4
texts["damaged"] = host.said()
report(texts)
"""
    said = fresh(tmp_path, run, fmu=fmu)
    assert len(said) == 26
    assert "damaged" in said.pop("damaged")
    assert "(fmi2SetupExperiment) must be called before" in said.pop("new: enter")
    assert "this FMU is at 0.5 s; go on there" in said.pop("stepping: jump")
    assert "this FMU is at 0.5 s; go on there" in said.pop("stepping: back")
    assert "goes past 0.7 s" in said.pop("stepping: past")
    assert all("can't be called" in text for text in said.values())


def test_after_a_discarded_step_only_a_restored_state_goes_on(tmp_path: Path) -> None:
    fmu = scripted(tmp_path / "fmu", slave("self.y += 1.0").replace("return True", "return h < 0.2"))
    run = """
host = Host(A.fmu)
assert host.initialize() == 0
kept = host.save()
assert host.step(0.0, 0.5) == 2 and host.get() == [1.0]
assert host.step(0.0, 0.1) == 4
said = host.said()
assert host.restore(kept) == 0 and host.step(0.0, 0.1) == 0
report([said, host.get()])
"""
    said, values = fresh(tmp_path, run, fmu=fmu)
    assert "after a discarded step; restore the FMU state" in said
    assert values == [1.0]
