"""What runs an isolated FMU on a machine of a Dask cluster: an actor of Dask, which starts its process and feeds it."""

from __future__ import annotations

import asyncio
import sys
import time
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from socket import gethostname
from typing import Any, TypeVar

from cosim.errors import SetupError, needs
from cosim.fmi.fmu_file import load
from cosim.fmi.isolation.limits import Limits
from cosim.fmi.isolation.process import Ending, WorkerProcess
from cosim.fmi.shared_library import library_path
from cosim.fmi.unpacking import folder_for_fmus
from cosim.loop.channel import ASKED_TO_LOAD, RelayToWorker, channel_library, functions
from cosim.versions import package_version

with needs("sweep"):
    from distributed import get_worker

#: How often (ns) one looks whether the process is there while it computes.
_LOOK = 50_000_000

T = TypeVar("T")


@dataclass(frozen=True)
class Order:
    """An FMU to run: its file, the interface that is used, the limits, and the version of who wants it."""

    fmu: bytes
    component: str
    interface: str
    build: bool
    limits: Limits
    version: str


@dataclass(frozen=True)
class Answer:
    """What has come of calls: the bytes of the area, the messages, and the last call; or how the process has ended."""

    area: bytes
    messages: bytes
    call: int
    ending: Ending | None = None


class Host:
    """An isolated FMU on this machine, for a run on another one.

    What needs long is done in a thread of its own: the worker of Dask goes on answering.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="cosim-host")
        self._stack = ExitStack()
        self._process: WorkerProcess | None = None
        self._identifier, self._library, self._limits = "", Path(), Limits()
        self._worker = get_worker()
        self._key = self._worker.get_current_task()
        weakref.finalize(self, self._stack.close)

    async def prepare(self, order: Order) -> str:
        """Check and unpack an FMU; the folder where it is.

        Raises
        ------
        SetupError
            It can't be run here.
        """
        return await self._in_thread(self._prepare, order)

    async def load(self) -> Answer:
        """Start the process, which loads the library."""
        return await self._in_thread(self._load)

    async def exchange(self, n_calls: int, calls: bytes) -> Answer:
        """Have calls made."""
        return await self._in_thread(self._exchange, n_calls, calls)

    async def call(self) -> int:
        """Number of the call that is being made, now."""
        return 0 if self._process is None else RelayToWorker(self._process.memory).call

    async def end(self) -> None:
        """End the process as it is, and remove the folder."""
        if self._process is not None:
            self._process.kill()
        await self._in_thread(self._stack.close)

    async def _in_thread(self, function: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)

    def _prepare(self, order: Order) -> str:
        if order.version != package_version():
            has = f"has closed-chain-cosim {package_version()}, the run is made by {order.version}"
            raise SetupError(f"{gethostname()} {has}; install the same")
        folder = Path(self._stack.enter_context(folder_for_fmus()))
        file = folder / "placed.fmu"
        file.write_bytes(order.fmu)
        unpacked = folder / "unpacked"
        try:
            fmu = load(order.component, file, order.interface)
            fmu.check_binary(build=order.build)
            fmu.unpack(unpacked, build=order.build)
            interface = fmu.description.coSimulation or fmu.description.modelExchange
            self._identifier = interface.modelIdentifier
            self._library = library_path(unpacked, fmu.description.fmiMajorVersion, self._identifier)
        except SetupError as error:
            text = str(error).replace(f"component '{order.component}': ", "").replace(f"{file}: ", "")
            raise SetupError(text) from None
        self._limits = order.limits
        return str(unpacked)

    def _load(self) -> Answer:
        self._process = WorkerProcess(self._library, self._identifier, self._limits)
        self._stack.callback(self._process.kill)
        answer = self._answer(self._process, ASKED_TO_LOAD, loads=True)
        if answer.ending is not None:
            return answer
        area: int = channel_library().channel_area()
        text = int.from_bytes(self._process.memory[area : area + 8], sys.byteorder)
        return replace(answer, area=self._process.memory[area : area + 8 + (text or len(functions()))])

    def _exchange(self, n_calls: int, calls: bytes) -> Answer:
        if self._process is None:  # Dask has made this actor anew, for the machine of the one before was lost
            return Answer(b"", b"", 0, Ending("its process is gone with its machine", says_all=True))
        return self._answer(self._process, RelayToWorker(self._process.memory).ask(n_calls, calls))

    def _answer(self, process: WorkerProcess, asked: int, *, loads: bool = False) -> Answer:
        relay, messages = RelayToWorker(process.memory), bytearray()
        began, longest = None, self._limits.call_time if loads else None
        while not relay.is_answered(asked, _LOOK):
            if longest is not None and process.is_loading():
                began = began or time.monotonic()
                if time.monotonic() - began > longest:
                    process.kill()
                    why = f"the loading of its library took longer than {longest:g} s, and its process was ended"
                    return Answer(b"", bytes(messages), 0, Ending(why, says_all=True))
            messages += relay.messages()
            if (ending := process.ending()) is not None:
                return Answer(b"", bytes(messages + relay.messages()), relay.call, ending)
            if self._worker.state.actors.get(self._key) is not self:  # whoever wanted it is gone
                process.kill()
        return Answer(relay.answer(), bytes(messages + relay.messages()), relay.call)
