"""The process of an isolated FMU, run as a script: it loads the FMU, and then calls come without Python."""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import signal
import sys
from typing import Any

#: In the area while the library is being loaded.
LOADING = bytes([255] * 8)


def main(memory_file: int, life: int) -> None:
    """Serve the channel in a file until the other end of a pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all processes; the master ends this one
    head = b""
    while not head.endswith(b"\n"):
        head += (got := os.read(life, 1 << 16))
        if not got:
            return
    task = json.loads(head)
    sys.path[:] = task["path"]

    from cosim.loop.channel import channel_library, functions

    library = channel_library()
    if not library.channel_end_with(life):
        os._exit(1)
    memory = mmap.mmap(memory_file, 0)
    os.close(memory_file)
    address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    area = library.channel_area()
    if task["memory"] is not None:
        _limit_memory(task["memory"])
    memory[area : area + 8] = LOADING
    found = _loaded(task["library"], task["identifier"], functions())
    if isinstance(found, str):
        text = found.encode(errors="replace")
        memory[area : area + 8 + len(text)] = len(text).to_bytes(8, sys.byteorder) + text
        library.channel_answer(address)
        return
    libraries, addresses = found
    memory[area : area + 8 + len(addresses)] = bytes(8) + bytes(a is not None for a in addresses)
    library.channel_serve(address, len(memory) - area, (ctypes.c_void_p * len(addresses))(*addresses))

    from cosim.fmi.loading import unload

    unload(libraries)


def _loaded(path: str, identifier: str, names: tuple[str, ...]) -> str | tuple[list[ctypes.CDLL], list[int | None]]:
    """A library and addresses of functions, None for those that it lacks; or why it can't be loaded."""
    from pathlib import Path

    from cosim.fmi.loading import LibraryError, load, names_in_library

    try:
        libraries = load(Path(path))
    except LibraryError as error:
        return str(error)
    addresses = []
    for name in names:
        found: Any = (getattr(libraries[0], n, None) for n in names_in_library(name, identifier))
        function = next((f for f in found if f is not None), None)
        addresses.append(None if function is None else ctypes.cast(function, ctypes.c_void_p).value)
    return libraries, addresses


def _limit_memory(more: int) -> None:
    """Let this process take so many bytes more than it has."""
    import resource

    if sys.platform == "linux":  # of data, for libraries reserve addresses that they never use
        with open("/proc/self/statm") as file:  # noqa: PTH123 (quick to import)
            now = int(file.read().split()[5]) * resource.getpagesize()
        kind = resource.RLIMIT_DATA
    else:
        now, kind = 0, resource.RLIMIT_AS
    resource.setrlimit(kind, (now + more, now + more))


def _end(code: int) -> None:
    """End at once: an FMU may have threads that never do."""
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)
    os._exit(code)


if __name__ == "__main__":
    try:
        main(int(sys.argv[1]), int(sys.argv[2]))
    except BaseException:
        sys.excepthook(*sys.exc_info())
        _end(1)
    _end(0)
