"""Scenarios in TOML that are broken, hostile, or unclean."""

from __future__ import annotations

from pathlib import Path

from tests.support.corpus.case import REFUSED, RUNS, Case, Materials, fmu_2

_PLAIN = """
[components]
a = {fmu = "x.fmu"}
b = {fmu = "x.fmu"}

[[connections]]
from = "a.y"
to = "b.u"

[run]
stop_time = 1.0
step_size = 0.1
"""


def _toml(name: str, text: str | bytes, says: str = "", expected: str = REFUSED) -> Case:
    def make(folder: Path, materials: Materials) -> Path:
        fmu_2(folder, materials)
        (folder / "s.toml").write_bytes(text.encode() if isinstance(text, str) else text)
        return folder / "s.toml"

    return Case(f"scenario: {name}", make, expected, says, "scenario")


def _and(name: str, more: str, says: str = "", expected: str = REFUSED) -> Case:
    return _toml(name, _PLAIN + more, says, expected)


def _with(name: str, before: str, after: str, says: str = "", expected: str = REFUSED) -> Case:
    assert before in _PLAIN
    return _toml(name, _PLAIN.replace(before, after), says, expected)


_START = "\n[start.a]\nu = {}\n"

SCENARIOS: tuple[Case, ...] = (
    _toml("as it is", _PLAIN, expected=RUNS),
    _toml("a text", "hello\n", "s.toml"),
    _toml("JSON", '{"components": {}}', "s.toml"),
    _toml("zeros", bytes(100), "s.toml"),
    _toml("bytes that are not UTF-8", b'title = "\xff"\n', "can't be read as TOML"),
    _toml("UTF-16", _PLAIN.encode("utf-16"), "s.toml"),
    _toml("a byte order mark", _PLAIN.encode("utf-8-sig"), ""),
    _toml("5,000 nested lists", "title = " + "[" * 5000 + "]" * 5000, "can't be read as TOML"),
    _toml("5,000 nested tables", "title = " + "{a=" * 5000 + "1" + "}" * 5000, "can't be read as TOML"),
    _toml("a key of 5,000 dots", ".".join("a" * 5000) + " = 1", "s.toml"),
    _toml("a number of 10,000 digits", "title = " + "9" * 10_000, "s.toml"),
    _and("a key twice", "\n[run]\nstop_time = 2.0\n", "can't be read as TOML"),
    _and("an unknown table", "\n[nothing]\n", "unknown key 'nothing'"),
    _toml("an unknown system", 'system = "nothing"\n' + _PLAIN, "nothing"),
    _toml("a title that is a number", "title = 3\n" + _PLAIN, "title = 3"),
    _toml("a title with an escape code", 'title = "\\u001b[2J\\u009b31m"\n' + _PLAIN, expected=RUNS),
    _with("components that are a text", '[components]\na = {fmu = "x.fmu"}\nb = {fmu = "x.fmu"}', 'components = "a"',
          "components"),
    _with("a component that is a text", '{fmu = "x.fmu"}\nb', '"x.fmu"\nb', "must be a table"),
    _with("a component without an FMU", '{fmu = "x.fmu"}\nb', "{}\nb", "lacks fmu"),
    _with("an FMU that is not there", 'fmu = "x.fmu"', 'fmu = "y.fmu"', "there is no such FMU file"),
    _with("an FMU that is a folder", 'fmu = "x.fmu"', 'fmu = "."', "there is no such FMU file"),
    _with("an FMU that is a device", 'fmu = "x.fmu"', 'fmu = "/dev/zero"', "there is no such FMU file"),
    _with("an FMU with a NUL in its name", 'fmu = "x.fmu"', 'fmu = "x\\u0000.fmu"', "there is no such FMU file"),
    _with("an FMU with a name of 5,000 characters", 'fmu = "x.fmu"', f'fmu = "{"x" * 5000}"', ""),
    _with("a component with a dot", "a = {", '"a.b" = {', "without a dot"),
    _with("a component without a name", "a = {", '"" = {', "without a dot"),
    _with("a component every 0 steps", 'fmu = "x.fmu"}\nb', 'fmu = "x.fmu", every = 0}\nb', "must be at least 1"),
    _with("a component every 10^30 steps", 'fmu = "x.fmu"}\nb', f'fmu = "x.fmu", every = {10**30}}}\nb',
          "every must be at most"),
    _with("a component every 2^32 steps", 'fmu = "x.fmu"}\nb', f'fmu = "x.fmu", every = {2**32}}}\nb',
          "every must be at most"),
    _with("a component every 10^4000 steps", 'fmu = "x.fmu"}\nb', f'fmu = "x.fmu", every = {10**4000}}}\nb',
          "every must be at most"),
    *(
        _with(f"a recording every {what} steps", "[run]", f"[run]\nrecord_every = {n}", "record_every must be below")
        for what, n in (("10^4000", 10**4000), ("2^64", 2**64), ("2^63", 2**63))
    ),
    _with("a connection of no component", '"a.y"', '"c.y"', "no component 'c'"),
    _with("a connection without a dot", '"a.y"', '"y"', "component.variable"),
    _with("a connection of no variable", '"a.y"', '"a.w"', "no variable 'w'"),
    _with("a connection of an input", '"a.y"', '"a.u"', "can't be the source"),
    _with("a connection that is a list", "[[connections]]\n", "[connections]\n", "must be a list of tables"),
    _with("a connection twice", "[run]", '[[connections]]\nfrom = "b.y"\nto = "b.u"\n\n[run]', "b.u"),
    _with("a factor of NaN", "[run]", "factor = nan\n\n[run]", "must be finite"),
    _with("a factor that is a text", "[run]", 'factor = "two"\n\n[run]', "must be a number"),
    _with("a stop of NaN", "stop_time = 1.0", "stop_time = nan", "must be finite"),
    _with("a stop of infinity", "stop_time = 1.0", "stop_time = inf", "must be finite"),
    _with("a stop before the start", "stop_time = 1.0", "stop_time = -1.0", "later than the start"),
    _with("a stop that is a text", "stop_time = 1.0", 'stop_time = "soon"', "must be a number"),
    _with("a stop that is a date", "stop_time = 1.0", "stop_time = 2020-01-01", "must be a number"),
    _with("a stop of 10^400", "stop_time = 1.0", f"stop_time = {10**400}", "must be finite"),
    _with("a step of 0", "step_size = 0.1", "step_size = 0.0", "must be positive"),
    _with("a step of 1e-300", "step_size = 0.1", "step_size = 1e-300", "step"),
    _with("a negative step", "step_size = 0.1", "step_size = -0.1", "must be positive"),
    _with("an unknown order", "[run]", '[run]\norder = "random"', "is unknown"),
    _with("a recording of nothing", "[run]", "[run]\nrecord = []", "records nothing"),
    _with("a recording of no variable", "[run]", '[run]\nrecord = ["a.w"]', "w"),
    _and("a start value that is a text", _START.format('"two"'), "u"),
    _and("a start value of NaN", _START.format("nan"), "u"),
    _and("a start value that is a list", _START.format("[1.0, 2.0]"), "u"),
    _and("a start value of no variable", "\n[start.a]\nw = 1.0\n", "no variable 'w'"),
    _and("a signal without a shape", '\n[signals."a.u"]\n', "lacks shape"),
    _and("a signal of an unknown shape", '\n[signals."a.u"]\nshape = "wild"\n', "is unknown"),
    _and("a signal from no file", '\n[signals."a.u"]\nshape = "csv"\nfile = "no.csv"\ncolumn = "u"\n', ""),
    _and("a metric of nothing", '\n[metrics.m]\nof = "a.w"\nmeasure = "rms"\n', ""),
    _and("a metric of an unknown measure", '\n[metrics.m]\nof = "a.y"\nmeasure = "beauty"\n', "beauty"),
)  # fmt: skip
