"""A command in a process of its own: an FMU that ends that process as if all was well does not make it a success.

The program waits for the process, passes signals on to it, and ends as it does. When the process has been told to end
and an FMU does not let it, the program ends it; and it clears away what a process leaves that an FMU has ended. So on
Linux; elsewhere a command runs in the program itself.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from cosim.loop import current_calls

#: Exit status for a process that an FMU has ended with that of success: an internal error, by sysexits.h.
STATUS_OF_EXIT = 70

#: What follows the last line of an FMU that ends the process, as in current_calls.c.
_REMEDY = "ask its supplier; isolated FMUs leave what was recorded (--isolated, isolate=True)"

#: Names of signals that are passed on to the process.
_PASSED_ON = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2")

#: A signal that comes twice within this time (s) is one: to the program, and to its group.
_SAME_SIGNAL = 0.1

#: Signals that tell the process to end.
_ENDING = (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))

#: A process that was told to end is looked at so often (s); one that is in the same call of an FMU each time in so many
#: looks is ended.
_LOOK, _MOST_LOOKS = 0.5, 20

#: Of prctl: signal that a process gets when its parent dies.
_PR_SET_PDEATHSIG = 1

#: Sizes of what a process shares with the program in memory: a path, and a line.
_PATH_SIZE, _LINE_SIZE = 4096, 8192

#: Path of the folder where the process writes results; the exit code plus one when it has written them, and the line
#: that it then has to say, if any.
_folder, _written = mmap.mmap(-1, _PATH_SIZE), mmap.mmap(-1, 1 + _LINE_SIZE)


def supervised(command: Callable[[], int]) -> int:
    """Exit code of a command, which runs in a process of its own where the platform has what that needs."""
    if sys.platform != "linux":
        return command()
    memory = current_calls.memory_of_calls()
    _forget(_folder)
    _forget(_written)
    program = os.getpid()
    sys.stdout.flush()
    sys.stderr.flush()
    process = os.fork()
    if process == 0:
        _become_the_process_of(program)
        current_calls.watched_memory = memory
        code = command()
        current_calls.has_finished(memory)
        return code
    code, stuck = _ended(process, memory)
    if _written[0] and not current_calls.is_finished(memory):
        return _ended_after_the_run(code, memory, stuck=stuck)
    if stuck:
        how = f"the run was told to end and could not within {_LOOK * _MOST_LOOKS:g} s, so it was killed"
    elif code < 0:
        how = f"{signal.Signals(-code).name} ended it"
    elif current_calls.is_finished(memory):
        return code
    else:
        how = f"it called _exit(), which an FMU must not do; {_REMEDY}"
        code = code or STATUS_OF_EXIT
    if text := current_calls.last_line(memory, how, "was stuck" if stuck else "ended the process"):
        print(text, file=sys.stderr, end="")
    elif not current_calls.is_told(memory) and code == STATUS_OF_EXIT:
        print("cosim: the process of the command ended before the command did", file=sys.stderr)
    _clear_away()
    return code if code > 0 else _end_by(-code)


def _become_the_process_of(program: int) -> None:
    """Get signals from the program alone, and none of its terminal; end with it however it ends."""
    os.setpgid(0, 0)
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # what it prints may not stop it
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != program:  # it has ended meanwhile
        os._exit(STATUS_OF_EXIT)


def works_in(folder: Path) -> None:
    """Say that the command writes into a folder of results, for the program to clear up there after a crash."""
    _share(_folder, 0, str(folder.absolute()))


def has_written(code: int, line: str = "") -> None:
    """Say that all results are in their place, and how the command ends whatever FMUs do when they are told to end.

    Parameters
    ----------
    code : int
        Exit code.
    line : str
        What is to be said on stderr then.
    """
    _share(_written, 1, line)
    _written[0] = code + 1


def _share(memory: mmap.mmap, first: int, text: str) -> None:
    memory[first:] = text.encode(errors="surrogateescape")[: len(memory) - first - 1].ljust(len(memory) - first, b"\0")


def _shared(memory: mmap.mmap, first: int = 0) -> str:
    return memory[first:].partition(b"\0")[0].decode(errors="surrogateescape")


def _forget(memory: mmap.mmap) -> None:
    memory[:] = bytes(len(memory))


def _ended_after_the_run(code: int, memory: mmap.mmap, *, stuck: bool) -> int:
    """Exit code of a process that an FMU has ended when its results were written."""
    from cosim.results.output import SUMMARY, amend_summary

    is_told = current_calls.is_told(memory)
    how = f"{signal.Signals(-code).name} ended it" if code < 0 else f"exit status {code}"
    text = current_calls.last_line(memory, how, "was stuck" if stuck else "ended the process", again=True).strip()
    text = text.removeprefix("cosim: ") or f"the process of the command has ended: {how}"
    if not is_told:
        print(f"cosim: {text}", file=sys.stderr)
    _clear_away(parts=False)
    if line := _shared(_written, 1):
        print(f"cosim: {line}", file=sys.stderr)
    elif folder := _shared(_folder):
        print(f"cosim: note: that was when the run was over; all its results are in {folder}", file=sys.stderr)
        amend_summary(Path(folder) / SUMMARY, {"process_ended": text})
    return 130 if stuck else _written[0] - 1


def _clear_away(*, parts: bool = True) -> None:
    """Remove temporary files of a process that has ended without doing so; say which `parts` of results there are."""
    from cosim.files.temporary import clear_abandoned
    from cosim.fmi.unpacking import place_for_fmus
    from cosim.results.output import clear_unfinished

    for place in {place_for_fmus(), Path(tempfile.gettempdir())}:
        clear_abandoned(place)
    if folder := _shared(_folder):
        found = clear_unfinished(Path(folder))
        for part in found if parts else ():
            print(f"cosim: what was recorded until then is in {part}", file=sys.stderr)


def _ended(process: int, memory: mmap.mmap) -> tuple[int, bool]:
    """Exit code of a process, once it has ended; of one that a signal has ended its number, negative.

    And whether it was told to end and did not, for an FMU in whose call it was.
    """
    last: dict[int, float] = {}
    looks: list[bytes] = []

    def look(_number: int, _frame: FrameType | None) -> None:
        calls = current_calls.calls_in(memory)
        if not calls or (looks and looks[-1] != calls):
            looks.clear()
        if calls:
            looks.append(calls)
        if len(looks) == _MOST_LOOKS:
            _send(process, signal.SIGKILL)

    def pass_on(number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if now - last.get(number, -_SAME_SIGNAL) >= _SAME_SIGNAL:
            last[number] = now
            _send(process, number)
            if number in _ENDING:
                signal.signal(signal.SIGALRM, look)
                signal.setitimer(signal.ITIMER_REAL, _LOOK, _LOOK)

    def stop(_number: int, _frame: FrameType | None) -> None:
        _send(process, signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)
        _send(process, signal.SIGCONT)

    handlers: dict[int, Any] = {getattr(signal, name): pass_on for name in _PASSED_ON}
    for number, handler in {**handlers, signal.SIGTSTP: stop}.items():
        if signal.getsignal(number) != signal.SIG_IGN:  # as that of background jobs is
            signal.signal(number, handler)
    _, status = os.waitpid(process, 0)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    return os.waitstatus_to_exitcode(status), len(looks) >= _MOST_LOOKS


def _send(process: int, number: int) -> None:
    """Send a signal to the group of a process, as a terminal does."""
    try:
        os.killpg(process, number)
    except ProcessLookupError:  # it is about to become one
        os.kill(process, number)


def _end_by(number: int) -> NoReturn:
    """End as the process did, without another core dump."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    if number not in (signal.SIGKILL, signal.SIGSTOP):  # these have no other handler
        signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
    os._exit(128 + number)
