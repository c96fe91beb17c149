"""A page for one person on this computer: tornado on the loopback, a random token, nothing else.

The address that is printed carries the token, which becomes a cookie; without it every answer is
403. A request whose `Host` is not that address is refused as well, so that no other page can reach
it by a name that resolves to the loopback.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.base.extras import needed
from jaxid.base.serialise import finite


LOOPBACK, COOKIE = "127.0.0.1", "jaxid"
#: Nothing but what this server sends; BokehJS sets styles as it draws.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self';"
    " img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
FILES = Path(__file__).parent

#: What an address answers: arguments of the request -> a value for JSON.
Answer = Callable[[Mapping[str, str]], Any]


class Site:
    """A page, files and answers in JSON at addresses of their own. `port` 0 takes any free one."""

    def __init__(self, page: str, files: Mapping[str, Path], answers: Mapping[str, Answer]):
        self._page, self._files, self._answers = page, dict(files), dict(answers)
        self.token = secrets.token_urlsafe(24)
        self.port = 0

    @property
    def address(self) -> str:
        """What to open, with the token."""
        return f"http://{LOOPBACK}:{self.port}/?token={self.token}"

    async def serve(self, port: int, ready: Callable[[str], None], stop: asyncio.Event) -> None:
        """Answers until `stop` is set; `ready` is told the address. Raises `UsageError` for a port
        that is taken.
        """
        web = needed("tornado.web")
        from tornado.httpserver import HTTPServer
        from tornado.netutil import bind_sockets

        try:
            sockets = bind_sockets(port, LOOPBACK)
        except OSError as error:
            raise UsageError(f"--port {port} cannot be had: {error.strerror}") from error
        self.port = sockets[0].getsockname()[1]
        server = HTTPServer(web.Application([(r"/(.*)", _handler(web), {"site": self})]))
        server.add_sockets(sockets)
        try:
            ready(self.address)
            await stop.wait()
        finally:
            server.stop()
            await server.close_all_connections()

    def hosts(self) -> tuple[str, ...]:
        """What a request may call this server."""
        return f"{LOOPBACK}:{self.port}", f"localhost:{self.port}"

    def knows(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())

    async def answer(self, name: str, arguments: Mapping[str, str]) -> tuple[str, bytes] | None:
        """Type and content of an address, None for one that is not there. An error of the user's is
        said as JSON.
        """
        if name == "":
            return "text/html; charset=utf-8", self._page.encode()
        if name in self._files:
            kind = "text/css" if name.endswith(".css") else "text/javascript"
            return f"{kind}; charset=utf-8", self._files[name].read_bytes()
        if name not in self._answers:
            return None
        loop = asyncio.get_running_loop()
        work = partial(self._answers[name], arguments)
        try:
            found = await loop.run_in_executor(None, work)
        except UsageError as error:
            found = {"error": str(error)}
        return "application/json", json.dumps(finite(found), allow_nan=False).encode()


def _handler(web: Any) -> Any:
    """The handler of all requests; its base is not known before tornado is there."""

    class Handler(web.RequestHandler):
        def initialize(self, site: Site) -> None:
            self.site = site

        def set_default_headers(self) -> None:
            self.set_header("Content-Security-Policy", POLICY)
            self.set_header("X-Content-Type-Options", "nosniff")
            self.set_header("Referrer-Policy", "no-referrer")
            self.set_header("Cache-Control", "no-store")

        async def get(self, name: str) -> None:
            given = self.get_query_argument("token", "")
            if self.request.host not in self.site.hosts():
                raise web.HTTPError(403)
            if given and self.site.knows(given) and not name:
                cookie = f"{COOKIE}{self.site.port}"
                self.set_cookie(cookie, given, httponly=True, samesite="Strict", path="/")
            elif not self.site.knows(self.get_cookie(f"{COOKIE}{self.site.port}") or ""):
                raise web.HTTPError(403)
            asked = {k: v[-1].decode() for k, v in self.request.query_arguments.items()}
            found = await self.site.answer(name, asked)
            if found is None:
                raise web.HTTPError(404)
            self.set_header("Content-Type", found[0])
            self.write(found[1])

        def write_error(self, status_code: int, **more: Any) -> None:
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.write("open the address that was printed, with its token\n")

        def log_exception(self, *what: Any) -> None:
            if not isinstance(what[1], web.HTTPError):
                super().log_exception(*what)

    return Handler


def run(site: Site, port: int, ready: Callable[[str], None]) -> None:
    """Serves until Ctrl-C."""

    async def main() -> None:
        await site.serve(port, ready, asyncio.Event())

    asyncio.run(main())


def bokeh_files() -> dict[str, Path]:
    """BokehJS as the package brings it: nothing is fetched from the network."""
    settings = needed("bokeh.settings").settings
    folder = Path(str(settings.bokehjs_path())) / "js"
    return {"bokeh.js": folder / "bokeh.min.js"}


def page(title: str, script: str) -> str:
    """The page around a script of this folder."""
    return (FILES / "page.html").read_text(encoding="utf-8").format(title=title, script=script)
