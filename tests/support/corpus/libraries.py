"""FMUs whose library is missing, none, for another machine, or does what no library may do."""

from __future__ import annotations

import struct
from collections.abc import Callable

from tests.support.corpus.case import (
    DESCRIPTION_2,
    DESCRIPTION_3,
    LIBRARY,
    LIBRARY_3,
    REFUSED,
    RUNS,
    STOPS,
    Case,
    Materials,
    Member,
    fmu_2,
    replaced,
    zipped,
)


def _members(
    name: str,
    members: Callable[[Materials], list[Member]],
    says: str = "",
    expected: str = REFUSED,
    is_valid: bool | None = None,
) -> Case:
    description = ("modelDescription.xml", DESCRIPTION_2.encode())
    return Case(
        name, lambda folder, m: zipped(folder / "x.fmu", description, *members(m)), expected, says,
        is_valid=is_valid,
    )  # fmt: skip


def _library(name: str, change: Callable[[bytes], bytes], says: str) -> Case:
    """The FMU with a changed library."""
    return _members(name, lambda m: [(LIBRARY, change(m.fmi2))], says)


def _without(function: str) -> Case:
    new = function[:-1] + ("0" if function[-1] != "0" else "1")
    return _library(f"no {function}", lambda b: b.replace(function.encode(), new.encode()), f"lacks {function}")


def _does(what: str, where: str, expected: str = STOPS, says: str = "", *options: str) -> Case:
    """The FMU that does something at a place."""
    return Case(
        f"{what} at {where}",
        lambda folder, m: fmu_2(folder, m, replaced(DESCRIPTION_2, "{GUID}", f"{what}@{where}")),
        expected,
        says,
        is_hostile=True,
        is_valid=True,
        arguments=("--set", "u=2", *options),
    )


def _told(when: str, what: str, expected: str) -> Case:
    """The FMU whose library does something when it is loaded or unloaded."""
    told = (f"{LIBRARY}.{when}", what.encode())
    return Case(
        f"{what} when it is {when}ed", lambda folder, m: fmu_2(folder, m, DESCRIPTION_2, told), expected,
        is_hostile=True,
        is_valid=True,
    )  # fmt: skip


def _with_text(what: str) -> Case:
    text = '<ScalarVariable name="t" valueReference="9" causality="output" variability="discrete"><String/></ScalarVariable>'
    xml = replaced(DESCRIPTION_2, "</ModelVariables>", text + "</ModelVariables>")
    xml = replaced(xml, "</Outputs>", '<Unknown index="3" dependencies=""/></Outputs>')
    xml = replaced(xml, "</InitialUnknowns>", '<Unknown index="3" dependencies=""/></InitialUnknowns>')
    return Case(
        f"an output that is a {what}", lambda folder, m: fmu_2(folder, m, replaced(xml, "{GUID}", f"{what}@get")), RUNS,
        is_hostile=True,
        is_valid=True,
    )  # fmt: skip


def _patched(place: int, new: bytes) -> Callable[[bytes], bytes]:
    return lambda data: data[:place] + new + data[place + len(new) :]


_PE = b"MZ" + bytes(58) + struct.pack("<I", 64) + b"PE\0\0" + struct.pack("<H", 0x8664) + bytes(200)
_ELSEWHERE = "binaries/win64/stranger.dll"

_BEFORE = ("instantiate", "setup", "enter", "set", "exit", "get")
_AFTER = ("terminate", "free")

LIBRARIES: tuple[Case, ...] = (
    _members("no library", lambda m: [], "has no binary for"),
    _members("a library for another platform only", lambda m: [(_ELSEWHERE, _PE)], "has no binary for", is_valid=True),
    _members("a library of another name", lambda m: [(LIBRARY.replace("stranger", "other"), m.fmi2)], "asks for"),
    _members("a library in another folder", lambda m: [("binaries/stranger.so", m.fmi2)], "has no binary for"),
    _members("a library at the top", lambda m: [("stranger.so", m.fmi2)], "has no binary for"),
    _members("a folder for the library", lambda m: [(f"{LIBRARY}/", b"")], ""),
    _members("sources only", lambda m: [("sources/stranger.c", b"int x;")], "--build", is_valid=True),
    _members("a library beside others", lambda m: [(LIBRARY, m.fmi2), (_ELSEWHERE, _PE)], expected=RUNS),
    _library("a library that is empty", lambda b: b"", "is damaged, or no library"),
    _library("a library that is a text", lambda b: b"no library\n", "is damaged, or no library"),
    _library("a library of zeros", lambda b: bytes(len(b)), "is damaged, or no library"),
    _library("a library that is a script", lambda b: b"#!/bin/sh\nexit 0\n", "is damaged, or no library"),
    _library("the first bytes of a library", lambda b: b[:60], "is damaged, or no library"),
    _library("half a library", lambda b: b[: len(b) // 2], "is damaged, or no library"),
    _library("a library cut off by a page", lambda b: b[:4096], "is damaged, or no library"),
    _library("a library of 32 bits", _patched(4, b"\1"), "can't be loaded"),
    _library("a library for 32-bit x86", _patched(18, b"\3"), "is for 32-bit x86 Linux"),
    _library("a library for ARM", _patched(18, b"\xb7"), "is for 64-bit ARM Linux"),
    _library("a library for an unknown processor", _patched(18, b"\xee\xee"), "is for processor"),
    _library("a library of Windows", lambda b: _PE, "Windows, and this process is"),
    _library("a library of macOS", lambda b: b"\xcf\xfa\xed\xfe\x07\0\0\1" + bytes(200), "macOS, and this process is"),
    _library("a program", _patched(16, b"\2"), "can't be loaded"),
    _library("segments behind the end", _patched(32, struct.pack("<Q", 2**40)), "is damaged, or no library"),
    _library("65,535 segments", _patched(56, b"\xff\xff"), "is damaged, or no library"),
    *(
        _without(name)
        for name in (
            "fmi2Instantiate", "fmi2FreeInstance", "fmi2SetupExperiment", "fmi2EnterInitializationMode",
            "fmi2ExitInitializationMode", "fmi2DoStep",
        )
    ),
    Case(
        "a library of FMI 2.0 for FMI 3.0",
        lambda folder, m: zipped(
            folder / "x.fmu", ("modelDescription.xml", DESCRIPTION_3.encode()), (LIBRARY_3, m.fmi2)
        ),
        REFUSED,
        "lacks fmi3InstantiateCoSimulation",
    ),
    # what a library does: before the first step, in a step, and after the last, when all results are there
    *(_does("abort", where, REFUSED) for where in _BEFORE),
    *(_does("abort", where) for where in ("step", "later")),
    *(_does("abort", where, RUNS) for where in _AFTER),
    *(_does("exit0", where, REFUSED) for where in ("instantiate", "exit", "get")),
    *(_does("exit0", where) for where in ("step", "later")),
    *(_does("exit0", where, RUNS) for where in _AFTER),
    *(_does(what, "later") for what in ("null", "stack", "kill", "term", "divide", "exit3", "quit0")),
    *(_does(what, "later") for what in ("error", "fatal", "nonsense")),
    *(_does(what, "later", STOPS, "", "--nonfinite", "error") for what in ("nan", "infinity")),
    *(_does(what, "instantiate", REFUSED) for what in ("quit0", "none")),
    *(_does(what, "exit", REFUSED) for what in ("error", "fatal")),
    *(_does(what, "terminate", RUNS) for what in ("error", "fatal")),
    _does("loop", "exit", REFUSED),
    _does("loop", "later"),
    *(_does(what, "step", RUNS) for what in ("chdir", "environment", "rounding", "deaf", "masked", "mode", "output")),
    # processes and threads of its own
    *(_does(what, "step", RUNS) for what in ("fork", "orphan", "spin")),
    *(_does(what, "later") for what in ("program", "thread", "leave", "alarm")),
    *(_does(what, "exit", REFUSED) for what in ("program", "leave")),
    *(_does(what, "free", RUNS) for what in ("program", "leave", "stop")),
    _does("at exit", "instantiate", RUNS),
    _does("stop", "later"),
    # what it shares with the process that it lives in
    *(_does(what, "later") for what in ("trap", "scribble", "beyond", "pending", "negative")),
    *(_does(what, "step", RUNS) for what in ("no files", "no room")),
    *(_told("load", what, REFUSED) for what in ("exit0", "abort", "program", "leave", "loop")),
    *(_told("unload", what, RUNS) for what in ("exit0", "abort", "program", "leave", "loop")),
    *(_does(what, "anywhere", RUNS) for what in ("escape", "noise")),
    _does("format", "anywhere", REFUSED),
    *map(_with_text, ("null text", "bytes")),
)  # fmt: skip
