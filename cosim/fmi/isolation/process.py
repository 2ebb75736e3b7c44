"""The process of an isolated FMU, as its master sees it: started, ended, and how it ended."""

from __future__ import annotations

import json
import mmap
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import SetupError
from cosim.fmi.isolation.limits import Limits
from cosim.fmi.isolation.worker import LOADING
from cosim.loop.channel import channel_library, make_channel

#: Size (bytes) of the memory of a channel; of it only what is used takes room.
CHANNEL_SIZE = 1 << 28

#: A process that has been told to end may take so long (s).
_LONGEST_END = 5.0

#: Flag of a thread of Linux that is ending, or has ended (PF_EXITING).
_EXITING = 4

_SCRIPT = Path(__file__).with_name("worker.py")

#: Signals that end a process, in words.
_WORDS = {
    "SIGSEGV": "segmentation fault, SIGSEGV",
    "SIGBUS": "bus error, SIGBUS",
    "SIGFPE": "arithmetic error, SIGFPE",
    "SIGILL": "illegal instruction, SIGILL",
    "SIGABRT": "it aborted, SIGABRT",
    "SIGKILL": "SIGKILL, by the system for want of memory or by somebody",
}


def can_isolate() -> bool:
    """Whether FMUs can be isolated on this platform."""
    return sys.platform != "win32"


def check_platform() -> None:
    """Whether FMUs can be isolated on this platform.

    Raises
    ------
    SetupError
        They can't.
    """
    if not can_isolate():
        raise SetupError("FMUs can't be isolated on Windows; run without isolation, or under Linux (WSL)")


@dataclass(frozen=True)
class Ending:
    """How the process of an FMU has ended.

    Attributes
    ----------
    what : str
        In words, as "its process ended with exit code 0"; "in" and the function that was called go on from there.
    has_called_exit : bool
        Whether it ended by a call of exit().
    was_killed : bool
        Whether it was killed, as by a system that is short of memory, and perhaps by no fault of its FMU.
    says_all : bool
        Whether these words are all that there is to say.
    """

    what: str
    has_called_exit: bool = False
    was_killed: bool = False
    says_all: bool = False


class WorkerProcess:
    """A process for one FMU, and the memory that is shared with it.

    The process ends with this object, and with it those that its FMU has started, but for those that have left its
    group. It watches a pipe whose other end is here, and which the system closes however this process ends.

    Parameters
    ----------
    library : Path
        The library of the FMU.
    identifier : str
        Its model identifier.
    limits : Limits
    """

    #: Whether it is on another machine.
    is_elsewhere = False

    def __init__(self, library: Path, identifier: str, limits: Limits) -> None:
        check_platform()
        self._began = time.monotonic()
        self._has_ended_group = self._has_lost_its_thread = False
        file = _unnamed_file(CHANNEL_SIZE)
        try:
            self.memory = mmap.mmap(file, CHANNEL_SIZE)
            make_channel(self.memory)
            life, self._life = os.pipe()
            command = [sys.executable, "-P", str(_SCRIPT), str(file), str(life)]
            try:
                with nullcontext() if limits.output is None else limits.output.open("ab") as output:
                    self._process = subprocess.Popen(
                        command,
                        stdin=subprocess.DEVNULL,
                        stdout=output,
                        stderr=output,
                        pass_fds=(file, life),
                        process_group=0,
                    )
            except OSError as error:
                os.close(self._life)
                raise SetupError(f"a process for the FMU can't be started: {error}") from error
            finally:
                os.close(life)
        finally:
            os.close(file)
        task = {"path": sys.path, "library": str(library.absolute()), "identifier": identifier, "memory": limits.memory}
        with suppress(BrokenPipeError):  # it has ended, which will be noticed
            os.write(self._life, json.dumps(task).encode() + b"\n")

    def __del__(self) -> None:
        if hasattr(self, "_process"):
            self.kill()

    @property
    def age(self) -> float:
        """Time (s) since its start."""
        return time.monotonic() - self._began

    @property
    def number(self) -> int:
        """Number of the process."""
        return self._process.pid

    def ending(self) -> Ending | None:
        """How the process has ended; None while it runs."""
        code = self._process.poll()
        if code is None:
            # looked at twice: in a process that is ending the others may not know yet that they are
            before, self._has_lost_its_thread = self._has_lost_its_thread, self._goes_on_without_its_thread()
            return Ending("its thread was ended (pthread_exit)") if before and self._has_lost_its_thread else None
        self._end_group()
        if code >= 0:
            return Ending(f"its process ended with exit code {code}", has_called_exit=True)
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return Ending(f"its process was ended ({_WORDS.get(name, name)})", was_killed=code == -signal.SIGKILL)

    def is_loading(self) -> bool:
        """Whether it has begun to load the library."""
        area: int = channel_library().channel_area()
        return self.memory[area : area + 8] == LOADING

    def note_call(self) -> None:
        """Have the memory say at which call the worker is, as it always does here."""

    def wait(self) -> None:
        """Wait for the end of a process that has been told to end; it is killed when that takes long."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LONGEST_END)
        self.kill()

    def kill(self) -> None:
        """End the process at once, and what its FMU has started."""
        self._end_group()
        self._process.kill()
        self._process.wait()
        if self._life >= 0:
            os.close(self._life)
            self._life = -1

    def _end_group(self) -> None:
        """End what the FMU has started, once: later the number of the group may be that of another one."""
        if not self._has_ended_group:
            self._has_ended_group = True
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)

    def _goes_on_without_its_thread(self) -> bool:
        """Whether the thread that calls the FMU has ended, and others are not about to."""
        threads = Path(f"/proc/{self._process.pid}/task")
        try:
            if _state_of(threads / str(self._process.pid))[0] != "Z":
                return False
            return any(not _state_of(thread)[1] & _EXITING for thread in threads.iterdir())
        except OSError:  # gone, or not Linux
            return False


def _state_of(thread: Path) -> tuple[str, int]:
    """State of a thread of Linux, as "Z" for one that has ended, and its flags."""
    fields = (thread / "stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return fields[0], int(fields[6])


def _unnamed_file(size: int) -> int:
    """A file of memory without a name, which is gone when nobody has it open."""
    if sys.platform == "linux":
        file = os.memfd_create("cosim")
    else:
        with tempfile.TemporaryFile() as opened:
            file = os.dup(opened.fileno())
    os.ftruncate(file, size)
    return file
