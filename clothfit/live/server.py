"""The server: one page over HTTP, and a WebSocket for everything live.

One loop of asyncio in one thread serves all clients; messages are done one after the other in a second thread, so that
a scene that is loaded delays no frame. Each client has a pump that sends the newest frame whenever the last one is
through: a slow client gets fewer frames, and nobody waits for it.

Only this machine reaches it, by the loopback address; whoever knows the token in the opened address may steer. Pages of
other origins, and names of other hosts that lead here, are refused.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from tornado import httpserver, netutil, web, websocket

from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live import wire
from clothfit.live.commands import answer, answer_long, head_of
from clothfit.live.session import Session
from clothfit.live.task import LONG, Answer, Loading
from clothfit.motion.motion import Motion
from clothfit.report.page import WEB, filled, import_map
from clothfit.scene.scene import Scene

HOST = "127.0.0.1"

FASTEST = 1 / 60
"""Seconds between two frames that are sent."""

MAXIMUM_HEADER, MAXIMUM_BODY = 16 << 10, 16 << 10
PING = 120.0
"""Seconds between two looks whether a client is there: more than its longest message, which may compile, takes."""

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


OWN = Path(__file__).parent / "web"


@lru_cache(maxsize=1)
def parts() -> dict[str, str]:
    """The page's parts, read once."""
    styles = [(WEB / "page.css").read_text("utf-8"), (OWN / "live.css").read_text("utf-8")]
    return {
        "style": "\n".join(styles),
        "imports": import_map([*sorted(WEB.glob("*.js")), *sorted(OWN.glob("*.js"))]),
        "page": (OWN / "live.html").read_text("utf-8"),
    }


def live_page(nonce: str) -> bytes:
    """The page, HTML in UTF-8, whose scripts have a nonce."""
    own = parts()
    return filled(own["page"], {"style": own["style"], "imports": own["imports"], "nonce": nonce}).encode("utf-8")


class Guarded(web.RequestHandler):
    """What every request must satisfy."""

    def initialize(self, server: Server) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        for name, value in {
            "Server": "clothfit", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
            "X-Frame-Options": "DENY", "Cache-Control": "no-store", "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
        }.items():  # fmt: skip
            self.set_header(name, value)

    def prepare(self) -> None:
        hosts, origin = self.server.hosts, self.request.headers.get("Origin")
        if self.request.host not in hosts:
            raise web.HTTPError(403, reason="Another host")
        if origin is not None and origin not in {f"http://{host}" for host in hosts}:
            raise web.HTTPError(403, reason="Another origin")
        given = self.get_query_argument("token", "")
        if not hmac.compare_digest(given.encode(), self.server.token.encode()):
            raise web.HTTPError(403, reason="The token is missing or wrong")

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

    def initialize(self, server: Server) -> None:
        super().initialize(server)
        self.waiting: deque[str | bytes] = deque()
        self.held = 0  # of what waits, characters or bytes
        self.newest: bytes | None = None
        self.allowed, self.looked, self.beyond = AT_ONCE, time.monotonic(), 0
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
        with suppress(websocket.WebSocketClosedError, asyncio.CancelledError):
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


class Server:
    """A server of one scene. `start` opens its port and begins to serve in the loop that runs."""

    def __init__(self, scene: Scene, target: Motion | None = None, port: int = 0, token: str | None = None) -> None:
        self.token = secrets.token_urlsafe(18) if token is None else token
        self.clients: set[Socket] = set()
        self._asked, self._pool = port, ThreadPoolExecutor(1, "clothfit messages")
        self._scene, self._target = scene, target
        self._pending = False

    async def start(self) -> None:
        """Open the port and begin. Raises InvalidInput where the port is taken."""
        self.loop, self._new = asyncio.get_running_loop(), asyncio.Event()
        try:
            sockets = netutil.bind_sockets(self._asked, HOST)
        except (OSError, OverflowError) as error:
            raise InvalidInput(f"port {self._asked}: {getattr(error, 'strerror', None) or error}") from None
        self.port: int = sockets[0].getsockname()[1]
        make = lambda: Session(self._scene, self.send_all, self.noted, self._target, self.later)  # noqa: E731
        self.session = await self.loop.run_in_executor(self._pool, make)
        rules = {"server": self}
        app = web.Application(
            [("/", Page, rules), ("/ws", Socket, rules), ("/scene.json", File, rules)],
            default_handler_class=Missing, default_handler_args=rules, log_function=lambda handler: None,
            websocket_ping_interval=PING, websocket_max_message_size=wire.LARGEST,
        )  # fmt: skip
        self._http = httpserver.HTTPServer(
            app, max_header_size=MAXIMUM_HEADER, max_body_size=MAXIMUM_BODY, max_buffer_size=wire.LARGEST + 4096,
            idle_connection_timeout=60, body_timeout=10,
        )  # fmt: skip
        self._http.add_sockets(sockets)
        self._pump = self.loop.create_task(self._send_frames())

    @property
    def address(self) -> str:
        """The address to open, with its token."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    @property
    def hosts(self) -> set[str]:
        """What this server may be called."""
        return {f"{name}:{self.port}" for name in (HOST, "localhost")}

    async def close(self) -> None:
        """Close all connections, end the thread and the process."""
        self._pump.cancel()
        self._http.stop()
        for client in list(self.clients):
            client.close(1001, "the server ends")
        await self.loop.run_in_executor(self._pool, self.session.close)
        self._pool.shutdown(wait=True, cancel_futures=True)
        await asyncio.wait([asyncio.ensure_future(self._http.close_all_connections())], timeout=2)

    async def do(self, act: Callable[[], Any]) -> Any:
        """Do something in the thread of the messages."""
        return await self.loop.run_in_executor(self._pool, act)

    def later(self, act: Callable[[], None]) -> None:
        """The same from any thread, without waiting."""
        with suppress(RuntimeError):  # it is closed
            self._pool.submit(act)

    def send_all(self, message: Any) -> None:
        """Send a message to all clients; from any thread."""
        if message is not None:
            data = message if isinstance(message, bytes) else wire.text_of(message)
            self._call(lambda: self._offer(data))

    def _offer(self, data: str | bytes) -> None:
        for client in list(self.clients):
            client.offer(data)

    def noted(self) -> None:
        """Note that there is a new frame; from the engine's thread, where it costs next to nothing."""
        if not self._pending:
            self._pending = True
            self._call(self._new.set)

    def _call(self, act: Callable[[], Any]) -> None:
        with suppress(RuntimeError):  # it is closed
            self.loop.call_soon_threadsafe(act)

    async def _send_frames(self) -> None:
        """Offer each new frame to all clients, no more often than a screen shows them."""
        error: ClothfitError | None = None
        while True:
            await self._new.wait()
            self._new.clear()
            self._pending = False
            data = self.session.frame_packet() if self.clients else None
            for client in list(self.clients):
                client.show(data)
            if self.session.engine.error is not error:
                error = self.session.engine.error
                self.send_all({"type": "status", **self.session.status()})
            self.session.again()
            await asyncio.sleep(FASTEST)


class Serving:
    """A server in a thread of its own, for Python and tests: `with Serving(scene) as server: server.address`."""

    def __init__(self, scene: Scene, target: Motion | None = None, port: int = 0, token: str | None = None) -> None:
        self.server = Server(scene, target, port, token)
        self._serves: Future[asyncio.Event] = Future()  # what ends it, when it has begun
        self._thread = threading.Thread(target=asyncio.run, args=[self._serve()], name="clothfit server", daemon=True)
        self._thread.start()
        self._stop = self._serves.result()

    @property
    def address(self) -> str:
        """The address to open, with its token."""
        return self.server.address

    def __enter__(self) -> Serving:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End the server."""
        if self._thread.is_alive():
            self.server.loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(10)

    async def _serve(self) -> None:
        try:
            await self.server.start()
        except BaseException as error:  # noqa: BLE001  # raised where the server was asked for
            self._serves.set_exception(error)
            return
        stop = asyncio.Event()
        self._serves.set_result(stop)
        await stop.wait()
        await self.server.close()
