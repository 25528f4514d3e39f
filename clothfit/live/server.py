"""The server: one page over HTTP, and a WebSocket for everything live.

One loop of asyncio in one thread serves all clients; messages are done one after the other in a second thread, so that
a scene that is loaded delays no frame. Each client has a pump that sends the newest frame whenever the last one is
through: a slow client gets fewer frames, and nobody waits for it.

Only this machine reaches it, by the loopback address; whoever knows the token in the opened address may steer. Pages of
other origins, and names of other hosts that lead here, are refused.
"""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from tornado import httpserver, netutil, web

from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live import wire
from clothfit.live.handlers import File, Missing, Page, Socket
from clothfit.live.session import Session
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene

HOST = "127.0.0.1"

FASTEST = 1 / 60
"""Seconds between two frames that are sent."""

MAXIMUM_HEADER, MAXIMUM_BODY = 16 << 10, 16 << 10
PING = 120.0
"""Seconds between two looks whether a client is there: more than its longest message, which may compile, takes."""


class Server:
    """A server of one scene. `start` opens its port and begins to serve in the loop that runs."""

    def __init__(self, scene: Scene, target: Motion | None = None, port: int = 0, token: str | None = None) -> None:
        self.token = secrets.token_urlsafe(18) if token is None else token
        self.clients: set[Socket] = set()
        self._asked, self._pool = port, ThreadPoolExecutor(1, "clothfit messages")
        self._scene, self._target = scene, target
        self._pending = False
        self.refused = 0  # connections that were turned away

    async def start(self) -> None:
        """Open the port and begin. Raises InvalidInput where the port is taken."""
        self.loop, self._new = asyncio.get_running_loop(), asyncio.Event()
        try:
            sockets = netutil.bind_sockets(self._asked, HOST)
        except (OSError, OverflowError) as error:
            raise InvalidInput(f"port {self._asked}: {getattr(error, 'strerror', None) or error}") from None
        self.port: int = sockets[0].getsockname()[1]
        make = lambda: Session(self._scene, self.tell, self.noted, self._target, self.later)  # noqa: E731
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
        try:
            self._pool.submit(act)
        except RuntimeError:  # it is closed
            return

    def tell(self, message: Any) -> None:
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
        try:
            self.loop.call_soon_threadsafe(act)
        except RuntimeError:  # the loop is closed
            return

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
                self.tell({"type": "status", **self.session.status()})
            self.session.again()
            await asyncio.sleep(FASTEST)


class Serving:
    """A server in a thread of its own, for Python and tests: `with serving(scene) as server: server.address`."""

    def __init__(self, scene: Scene, target: Motion | None = None, port: int = 0, token: str | None = None) -> None:
        self.server = Server(scene, target, port, token)
        self._ready = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="clothfit server", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error

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

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:  # noqa: BLE001  # raised where the server was asked for
            self._error = error
            self._ready.set()

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        await self.server.start()
        self._ready.set()
        await self._stop.wait()
        await self.server.close()


