"""The process that serves the live page: rows come by its standard input, commands go by its standard output.

A browser that is slow, or a page that asks for much, so takes no time from the run. Lines are JSON, both ways.
"""

from __future__ import annotations

import asyncio
import json
import sys
import threading
from collections import deque
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from cosim.errors import needs
from cosim.page.server import LoopbackHandler, page_routes

with needs("live"):
    import tornado.httpserver
    import tornado.iostream
    import tornado.netutil
    import tornado.web

#: So many characters of messages are kept for a page that is opened late; the oldest go first.
_MOST_KEPT = 64_000_000

#: A page is told what is left when the run has ended for so long (s).
_FLUSH = 1.0


class Hub:
    """What has come of the run, and who wants to know."""

    def __init__(self) -> None:
        self._kept: deque[str] = deque()
        self._size = 0
        self._progress = ""  # the latest stands for all before it
        self.listeners: set[asyncio.Queue[str]] = set()

    @property
    def kept(self) -> list[str]:
        """What a page that is opened now has to know."""
        return [*self._kept, self._progress] if self._progress else list(self._kept)

    def take(self, line: str) -> None:
        """Keep a message, and pass it on."""
        if line.startswith('{"progress"'):
            self._progress = line
        else:
            self._kept.append(line)
            self._size += len(line)
            while self._size > _MOST_KEPT:
                self._size -= len(self._kept.popleft())
        for listener in self.listeners:
            listener.put_nowait(line)


class _Rows(LoopbackHandler):
    """The stream of messages, as server-sent events."""

    def initialize(self, hub: Hub) -> None:
        self._hub = hub

    async def get(self) -> None:
        self.set_header("Content-Type", "text/event-stream")
        queue: asyncio.Queue[str] = asyncio.Queue()
        for line in self._hub.kept:
            queue.put_nowait(line)
        self._hub.listeners.add(queue)
        _tell({"connected": True})
        try:
            while True:
                self.write(f"data: {await queue.get()}\n\n")
                await self.flush()
        except tornado.iostream.StreamClosedError:
            return
        finally:
            self._hub.listeners.discard(queue)


class _Command(LoopbackHandler):
    """Commands of the page, and of no other."""

    def post(self) -> None:
        origin = self.request.headers.get("Origin", "")
        if urlsplit(origin).netloc != self.request.host:
            raise tornado.web.HTTPError(403)
        try:
            command = json.loads(self.request.body)
        except ValueError as error:
            raise tornado.web.HTTPError(400) from error
        if not _is_command(command):
            raise tornado.web.HTTPError(400)
        _tell(command)


def _is_command(message: Any) -> bool:
    """Whether a message is what the page sends: numbers to set, or what to do."""
    if not isinstance(message, dict) or not set(message) <= {"set", "pause", "resume", "stop"}:
        return False
    values = message.get("set", {})
    return isinstance(values, dict) and all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in values.values()
    )


def _tell(message: dict[str, Any]) -> None:
    """A line for the run, which may be gone."""
    try:
        print(json.dumps(message), flush=True)
    except BrokenPipeError:
        return


async def serve() -> None:
    """Serve until the standard input ends."""
    page = json.loads(sys.stdin.readline())["page"]
    hub, ended, loop = Hub(), asyncio.Event(), asyncio.get_running_loop()
    token, routes = page_routes(page)
    routes += [(rf"/{token}/rows", _Rows, {"hub": hub}), (rf"/{token}/command", _Command)]
    application = tornado.web.Application(routes, log_function=lambda handler: None)
    (socket,) = tornado.netutil.bind_sockets(0, "127.0.0.1")
    server = tornado.httpserver.HTTPServer(application)
    server.add_socket(socket)
    _tell({"address": f"http://127.0.0.1:{socket.getsockname()[1]}/{token}/"})

    def read() -> None:
        for line in sys.stdin:
            loop.call_soon_threadsafe(hub.take, line.strip())
        loop.call_soon_threadsafe(ended.set)

    threading.Thread(target=read, daemon=True).start()
    await ended.wait()
    await asyncio.sleep(_FLUSH if hub.listeners else 0.0)
    server.stop()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        asyncio.run(serve())
