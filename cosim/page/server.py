"""A page on the loopback, for whoever has its address: the file with all values answers what it asks for."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self

from cosim.errors import needs

with needs("live"):
    import tornado.httpserver
    import tornado.netutil
    import tornado.web

#: Path behind the token -> function of the query's parameters, whose value is sent as JSON.
Answers = Mapping[str, Callable[[Mapping[str, str]], Any]]

#: Names by which a browser reaches the loopback; another one is a page of others that tries to (DNS rebinding).
_HOSTS = ("127.0.0.1", "localhost")


def page_routes(page: str) -> tuple[str, list[Any]]:
    """A token that nobody can guess, and the routes of tornado to a page behind it."""
    token = secrets.token_urlsafe(16)
    return token, [(rf"/{token}/", _Page, {"page": page})]


class PageServer:
    """A server of one page and what it asks for, on a free port of 127.0.0.1; a context.

    Its address has a token, without which nothing is answered, and a request must name the loopback as its host.

    Parameters
    ----------
    page : str
        HTML; its security policy must let it ask its own server.
    answers : mapping
        Path -> function of the query's parameters.

    Attributes
    ----------
    address : str
        Of the page.
    """

    def __init__(self, page: str, answers: Answers) -> None:
        token, routes = page_routes(page)
        routes += [(rf"/{token}/{path}", _Answer, {"answer": answer}) for path, answer in answers.items()]
        self._application = tornado.web.Application(routes, log_function=lambda handler: None)
        (self._socket,) = tornado.netutil.bind_sockets(0, "127.0.0.1")
        self.address = f"http://127.0.0.1:{self._socket.getsockname()[1]}/{token}/"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    async def serve(self) -> None:
        """Answer until the task is cancelled."""
        server = tornado.httpserver.HTTPServer(self._application)
        server.add_socket(self._socket)
        try:
            await asyncio.Event().wait()
        finally:
            server.stop()
            await server.close_all_connections()

    def run(self) -> None:
        """Answer until Ctrl-C."""
        try:
            asyncio.run(self.serve())
        except KeyboardInterrupt:
            return


class LoopbackHandler(tornado.web.RequestHandler):
    """Refuses whoever does not name the loopback."""

    def prepare(self) -> None:
        """Refuse a request for another host."""
        if self.request.host_name not in _HOSTS:
            raise tornado.web.HTTPError(421)

    def set_default_headers(self) -> None:
        """Keep nothing, and tell nobody."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.clear_header("Server")


class _Page(LoopbackHandler):
    def initialize(self, page: str) -> None:
        self._page = page

    def get(self) -> None:
        self.write(self._page)


class _Answer(LoopbackHandler):
    def initialize(self, answer: Callable[[Mapping[str, str]], Any]) -> None:
        self._answer = answer

    def get(self) -> None:
        query = {name: self.get_query_argument(name) for name in self.request.query_arguments}
        try:
            found = self._answer(query)
        except (KeyError, ValueError) as error:
            raise tornado.web.HTTPError(400) from error
        self.write(found)
