"""Isolated FMUs on machines of a Dask cluster, as their master sees them."""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import mmap
import pickle
import sys
import threading
import time
import uuid
from contextlib import AbstractContextManager, suppress
from typing import TYPE_CHECKING, Any, cast

from cosim.cluster import client_of, quiet, workers_of
from cosim.errors import CosimError, SetupError, nearest, needs
from cosim.fmi.fmu_file import LoadedFMU
from cosim.fmi.interfaces import CO_SIMULATION, MODEL_EXCHANGE, is_model_exchange
from cosim.fmi.isolation.limits import Limits
from cosim.fmi.isolation.process import CHANNEL_SIZE, Ending, check_platform
from cosim.loop.channel import ASKED_TO_LOAD, RelayToMaster, make_channel
from cosim.versions import package_version

if TYPE_CHECKING:
    from distributed import Actor, Client, Future

    from cosim.fmi.isolation.host import Answer, Host

#: How often (s) what waits looks whether it is wanted any longer; how long the end of a process may take.
_LOOK, _LOOK_NS, _LONGEST_END = 0.2, 200_000_000, 5.0

#: How long (s) one waits until the master has made room for messages.
_ROOM = 1e-3

#: How long (s) a machine may take to answer over a connection of our own; else all goes through the scheduler.
_DIRECT = 3.0


class Hosts:
    """The machines of a Dask cluster on which FMUs can be placed.

    Parameters
    ----------
    scheduler : str, optional
        Address of its scheduler; by default that of the configuration of Dask (DASK_SCHEDULER_ADDRESS).

    Raises
    ------
    SetupError
        There is none, it does not answer, or it has no workers.
    """

    def __init__(self, scheduler: str | None) -> None:
        check_platform()
        with needs("sweep"):
            import dask
        scheduler = scheduler or dask.config.get("scheduler-address", None)
        if not scheduler:
            raise SetupError(
                "FMUs with a place need a scheduler, whose workers run them; give its address with --scheduler "
                "(in Python: scheduler=)"
            )
        self._quiet = quiet()
        self._quiet.__enter__()
        try:
            self._scheduler = scheduler
            self._client: Client = client_of(scheduler, SetupError)
        except BaseException:
            self._quiet.__exit__(None, None, None)
            raise
        self._is_direct: bool | None = None

    def close(self) -> None:
        """Leave the cluster."""
        self._client.close(timeout=_LONGEST_END)
        self._quiet.__exit__(None, None, None)

    def check(self, place: str) -> None:
        """Whether there is such a place.

        Raises
        ------
        SetupError
            There is none.
        """
        self._restrictions(place)

    def _restrictions(self, place: str) -> dict[str, Any]:
        """How Dask is told to choose a worker for a place."""
        workers = workers_of(self._client)
        if place in workers:
            return {"workers": [place], "allow_other_workers": False}
        tags = {tag for worker in workers.values() for tag in worker.get("resources", {})}
        if place in tags:
            return {"resources": {place: 1}}
        raise SetupError(
            f"{self._scheduler} has no worker at the address '{place}', nor one with such a resource; "
            f"{nearest(place, [*workers, *sorted(tags)])}"
        )

    def begin(self, place: str, component: str) -> Future[Host]:
        """Have Dask make a host, see `cosim.fmi.isolation.host`, at a place; a future of its actor.

        Raises
        ------
        SetupError
            There is no such place.
        """
        from cosim.fmi.isolation.host import Host

        key = f"cosim-{component}-{uuid.uuid4()}"
        future: Future[Host] = self._client.submit(Host, key=key, actor=True, pure=False, **self._restrictions(place))
        return future

    def actor_of(self, future: Future[Host], timeout: float) -> Actor:
        """The actor that Dask has made, for the thread that calls.

        Raises
        ------
        TimeoutError
            It has not made it within that time (s).
        """
        found = cast("Actor", future.result(timeout=timeout))
        if self._is_direct is None:
            self._is_direct = self._client.direct_to_workers = self._reaches(found._address)
        return cast("Actor", pickle.loads(pickle.dumps(found)))  # one that has found our client and no other

    def _reaches(self, address: str) -> bool:
        """Whether a worker can be reached from here, and not through its scheduler only."""

        async def answers() -> bool:
            with suppress(OSError, TimeoutError):
                await asyncio.wait_for(self._client.rpc(address).identity(), _DIRECT)
                return True
            return False

        return bool(self._client.sync(answers))

    def current(self) -> AbstractContextManager[Any]:
        """Context in which actors belong to this cluster."""
        return cast("AbstractContextManager[Any]", self._client.as_current())

    def process(self, place: str, fmu: LoadedFMU, component: str, *, build: bool, limits: Limits) -> PlacedProcess:
        """A process for the FMU of a component at a place."""
        return PlacedProcess(self, place, fmu, component, build=build, limits=limits)


class PlacedProcess:
    """The process of an FMU on another machine: what `WorkerProcess` is for one on this machine.

    A thread carries what is asked and answered between the memory of the channel and the actor that feeds the process.

    Attributes
    ----------
    memory : mmap
        Of the channel.
    folder : str
        Where the FMU is unpacked there, once it is loaded.
    """

    is_elsewhere = True

    def __init__(
        self, hosts: Hosts, place: str, fmu: LoadedFMU, component: str, *, build: bool, limits: Limits
    ) -> None:
        self.memory = mmap.mmap(-1, CHANNEL_SIZE)
        make_channel(self.memory)
        self.folder = ""
        self._hosts, self._place, self._fmu, self._component, self._build = hosts, place, fmu, component, build
        self._limits = dataclasses.replace(limits, output=None)
        self._relay = RelayToMaster(self.memory)
        self._began = time.monotonic()
        self._future: Future[Host] | None = None
        self._actor: Actor | None = None
        self._ending: Ending | None = None
        self._is_lost = False
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._carry, name=f"cosim-{component}", daemon=True)
        self._thread.start()

    @property
    def age(self) -> float:
        """Time (s) since its start."""
        return time.monotonic() - self._began

    def ending(self) -> Ending | None:
        """How the process has ended, or that its machine is lost; None while all is well."""
        future = self._future if self._actor is not None and self._ending is None else None
        if future is not None and future.status != "finished":
            self._ending = self._lost(f"its worker is gone: {future.status}")
        return self._ending

    def is_loading(self) -> bool:
        """See `WorkerProcess`; on its machine one sees to it that the loading does not take too long."""
        return False

    def note_call(self) -> None:
        """Have the memory say at which call the worker is."""
        if self._actor is not None and self._ending is None:
            with suppress(Exception), self._hosts.current():
                self._relay.note_call(self._actor.call().result(timeout=_LONGEST_END))

    def wait(self) -> None:
        """Wait for the end of a process that has been told to end."""
        self.kill()

    def kill(self) -> None:
        """End the process at once, as far as its machine can be told."""
        if self._is_over.is_set():
            return
        self._is_over.set()
        if self._actor is not None and not self._is_lost:
            with suppress(Exception), self._hosts.current():
                self._actor.end().result(timeout=_LONGEST_END)
        self._future = self._actor = None  # Dask forgets the host

    # The thread

    def _carry(self) -> None:
        try:
            with self._hosts.current():
                self._actor = actor = self._made()
                if actor is None or not self._is_loaded(actor):
                    return
                before, asked = ASKED_TO_LOAD, ASKED_TO_LOAD
                while not self._is_over.is_set():
                    before, asked = asked, self._relay.asked(asked, _LOOK_NS)
                    if asked != before and not self._is_answered(
                        asked, actor.exchange(*self._relay.request()).result()
                    ):
                        return
        except CosimError as error:
            self._refuse(str(error))
        except Exception as error:
            self._ending = self._lost(" ".join(f"{type(error).__name__}: {error}".split()))

    def _made(self) -> Actor | None:
        """The actor, once Dask has made it; a worker that is busy makes it later. None where it is no longer wanted."""
        future = self._future = self._hosts.begin(self._place, self._component)
        while not self._is_over.is_set():
            with suppress(TimeoutError):
                return self._hosts.actor_of(future, _LOOK)
        return None

    def _is_loaded(self, actor: Actor) -> bool:
        from cosim.fmi.isolation.host import Order

        interface = MODEL_EXCHANGE if is_model_exchange(self._fmu.description) else CO_SIMULATION
        data = self._fmu.path.read_bytes()
        if hashlib.sha256(data).hexdigest() != self._fmu.sha256:
            raise SetupError("was changed while it was read; run it again")
        order = Order(data, self._component, interface, self._build, self._limits, package_version())
        self.folder = actor.prepare(order).result()
        return self._is_answered(ASKED_TO_LOAD, actor.load().result())

    def _is_answered(self, asked: int, answer: Answer) -> bool:
        """Put an answer where the master finds it; false where there is none, and there will be no more."""
        messages = answer.messages
        while messages := self._relay.hand_on(messages):
            if self._is_over.wait(_ROOM):
                return False
        self._relay.note_call(answer.call)
        if answer.ending is not None:
            what = answer.ending.what.replace("its process", f"its process on {self._place}", 1)
            self._ending = dataclasses.replace(answer.ending, what=what)
            return False
        self._relay.write(answer.area)
        self._relay.answer(asked)
        return True

    def _refuse(self, why: str) -> None:
        """Say why the FMU can't be loaded."""
        text = f"can't be run on {self._place}: {why}".encode()
        self._relay.write(len(text).to_bytes(8, sys.byteorder) + text)
        self._relay.answer(ASKED_TO_LOAD)

    def _lost(self, why: str) -> Ending:
        self._is_lost = True
        return Ending(f"its host {self._place} was lost ({why})", was_killed=True, says_all=True)
