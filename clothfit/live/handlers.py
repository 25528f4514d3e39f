"""What answers a request: the page, the scene as a file, and the WebSocket of a client."""

from __future__ import annotations

import asyncio
import hmac
import secrets
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from tornado import web, websocket

from clothfit.base.errors import InvalidInput
from clothfit.live import wire
from clothfit.live.commands import answer, answer_long, head_of
from clothfit.live.page import live_page
from clothfit.live.session import Session
from clothfit.live.task import LONG, Answer, Loading

MOST_CLIENTS = 16
MOST_WAITING, MOST_BYTES = 1000, 32 << 20
"""Messages that wait for a client that does not read, and what they hold together; with more it is cut off."""

PER_SECOND, AT_ONCE = 200.0, 400.0
"""Messages of a client that are done, on the average and in a burst; more are refused."""

MOST_REFUSED = 2000
"""Messages beyond these in a row, with which a client is cut off."""

POLICY = (
    "default-src 'none'; script-src 'nonce-{nonce}' data:; style-src 'unsafe-inline'; img-src data: blob:; "
    "connect-src 'self' {socket}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Host(Protocol):
    """What answers need of the server."""

    token: str
    hosts: set[str]
    clients: set[Socket]
    session: Session
    refused: int

    async def do(self, act: Callable[[], Any]) -> Any:
        """Do something in the thread of the messages."""


class Guarded(web.RequestHandler):
    """What every request must satisfy."""

    def initialize(self, server: Host) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        for name, value in {
            "Server": "clothfit", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
            "X-Frame-Options": "DENY", "Cache-Control": "no-store", "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
        }.items():  # fmt: skip
            self.set_header(name, value)

    def prepare(self) -> None:
        reason = self.fault()
        if reason:
            self.server.refused += 1
            raise web.HTTPError(403, reason=reason)

    def fault(self) -> str | None:
        """Why a request is refused, if it is."""
        if self.request.host not in self.server.hosts:
            return "Another host"
        origin = self.request.headers.get("Origin")
        if origin is not None and origin not in {f"http://{host}" for host in self.server.hosts}:
            return "Another origin"
        given = self.get_query_argument("token", "")
        if not hmac.compare_digest(given.encode(), self.server.token.encode()):
            return "The token is missing or wrong"
        return None

    def log_exception(self, *error: Any) -> None:
        """Write nothing on the terminal of what strangers ask for."""
        if not isinstance(error[1], web.HTTPError):
            super().log_exception(*error)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        more = "; open the whole address that clothfit serve printed" if status_code == 403 else ""
        self.finish(f"{status_code} {self._reason}{more}\n")


class Page(Guarded):
    """The page."""

    def get(self) -> None:
        nonce = secrets.token_hex(16)
        self.set_header("Content-Security-Policy", POLICY.format(nonce=nonce, socket=f"ws://{self.request.host}"))
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(live_page(nonce))


class File(Guarded):
    """The scene as a file."""

    async def get(self) -> None:
        data = await self.server.do(self.server.session.text)
        self.set_header("Content-Type", "application/json")
        self.set_header("Content-Disposition", 'attachment; filename="scene.json"')
        self.finish(data)


class Missing(Guarded):
    """Any other path."""

    def prepare(self) -> None:
        super().prepare()
        raise web.HTTPError(404)


class Socket(Guarded, websocket.WebSocketHandler):
    """A client."""

    def initialize(self, server: Host) -> None:
        super().initialize(server)
        self.waiting: deque[str | bytes] = deque()
        self.held = 0  # of what waits, characters or bytes
        self.newest: bytes | None = None
        self.allowed, self.looked, self.beyond = AT_ONCE, time.monotonic(), 0
        self.sent = 0  # frames
        self.gone = False

    def prepare(self) -> None:
        super().prepare()
        if len(self.server.clients) >= MOST_CLIENTS:
            raise web.HTTPError(503, reason="Too many clients")

    def check_origin(self, origin: str) -> bool:
        return True  # `prepare` has looked

    async def open(self, *arguments: str, **keywords: str) -> None:
        """Tell a new client everything, and begin to send frames."""
        self.set_nodelay(True)
        self.filled = asyncio.Event()
        session = self.server.session
        scene, status, target = await self.server.do(
            lambda: (wire.text_of(session.scenery()), session.status(), session.target_packet())
        )
        if self.gone:  # meanwhile
            return
        for each in (scene, target, wire.text_of({"type": "status", **status})):
            if each is not None:
                self.offer(each)
        self.show(session.frame_packet())
        self.server.clients.add(self)
        self.pump = asyncio.ensure_future(self._send())

    def offer(self, data: str | bytes) -> None:
        """Send a message that must not be lost."""
        if self.gone:
            return
        self.held += len(data)
        if self.waiting and (len(self.waiting) >= MOST_WAITING or self.held > MOST_BYTES):
            self.abort()
            return
        self.waiting.append(data)
        self.filled.set()

    def show(self, frame: bytes | None) -> None:
        """Send a frame, unless a newer one comes before it could be sent; None takes back one of another scene."""
        self.newest = frame
        self.filled.set()

    async def _send(self) -> None:
        """Send what waits, one after the other, each when the last one has gone."""
        try:
            while True:
                await self.filled.wait()
                self.filled.clear()
                while self.waiting:
                    data = self.waiting.popleft()
                    self.held -= len(data)
                    await self.write_message(data, binary=isinstance(data, bytes))
                if self.newest is not None:
                    frame, self.newest = self.newest, None
                    await self.write_message(frame, binary=True)
                    self.sent += 1
        except (websocket.WebSocketClosedError, asyncio.CancelledError):
            return

    async def on_message(self, message: str | bytes) -> None:
        """Answer a message, or refuse it with a reason; of a scene that is loaded when it is there."""
        found = await self._answered(message)
        if isinstance(found, Loading):
            self.waits = asyncio.ensure_future(self._when_loaded(found))
        else:
            self.offer(wire.text_of(found))

    async def _when_loaded(self, loading: Loading) -> None:
        """Answer who loads a scene; meanwhile other messages are answered."""
        answered = asyncio.wrap_future(loading.answer)
        done, _ = await asyncio.wait([answered], timeout=LONG)
        found = None if done else await self.server.do(lambda: self.server.session.still_loading(loading))
        self.offer(wire.text_of(found or await answered))

    async def _answered(self, message: str | bytes) -> Answer | Loading:
        if not self._may():
            return {"type": "refused", "reason": f"too many messages: {PER_SECOND:g} a second at most"}
        session = self.server.session
        if len(message) > wire.ORDINARY and wire.loads(message):
            return await self._done(lambda: answer_long(session, str(message)), {"of": "load"})
        try:
            parsed = wire.parsed(message)
        except InvalidInput as error:
            return {"type": "refused", **wire.guessed_id(message), "reason": str(error)}
        return await self._done(lambda: answer(session, parsed), head_of(parsed))

    async def _done(self, act: Callable[[], Answer | Loading], head: Answer) -> Answer | Loading:
        """What an act answers; a fault of the program must cost its sender alone."""
        try:
            found: Answer | Loading = await self.server.do(act)
        except Exception as error:  # noqa: BLE001
            return {"type": "refused", **head, "reason": f"a fault of the program: {error!r:.200}"}
        return found

    def _may(self) -> bool:
        """Whether a client may ask for something now."""
        now = time.monotonic()
        self.allowed = min(self.allowed + PER_SECOND * (now - self.looked), AT_ONCE)
        self.looked = now
        if self.allowed < 1.0:
            self.beyond += 1
            if self.beyond > MOST_REFUSED:
                self.abort()
            return False
        self.allowed, self.beyond = self.allowed - 1.0, 0
        return True

    def abort(self) -> None:
        """Cut the connection off."""
        self.server.clients.discard(self)
        self.gone = True
        self.waiting.clear()
        if self.ws_connection is not None and self.ws_connection.stream is not None:
            self.ws_connection.stream.close()

    def on_close(self) -> None:
        self.gone = True
        self.server.clients.discard(self)
        if hasattr(self, "pump"):
            self.pump.cancel()
