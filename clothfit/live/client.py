"""A client of `clothfit serve` in Python, by tornado's WebSocket.

A thread reads what the server sends and keeps the newest frame, so that `latest` never waits.
"""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

from clothfit.base.arrays import Array
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live import wire

LARGEST = 1 << 30
"""Bytes of a message from the server, which may be a long target."""

CLOSING = 1.0
"""Seconds that a server has to take leave."""


class Connection:
    """A connection to a server; `connect` makes one. Use it in a `with` block, or call `close`."""

    def __init__(self, address: str, timeout: float) -> None:
        self.timeout, self._closed = timeout, False
        self._news = threading.Condition()
        self._frame: wire.Packet | None = None
        self._answers: dict[int, dict[str, Any]] = {}
        self._last = 0
        self.target: Array | None = None  # (frames, n, 3), m
        self.scene: dict[str, Any] = {}  # as docs/serve.md describes it
        self.heard: dict[str, dict[str, Any]] = {}  # the last message of each type
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="clothfit client", daemon=True)
        self._thread.start()
        try:
            opening = asyncio.run_coroutine_threadsafe(opened(address, timeout, self._take), self._loop)
            self._socket = opening.result()
        except BaseException:
            self._end()
            raise
        if not self._wait(lambda: bool(self.scene) and self._frame is not None):
            self.close()
            raise InvalidInput(f"{address.partition('?')[0]}: the server sends no scene")

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def latest(self) -> tuple[int, Array]:
        """The number of the newest frame that has come, and its positions (n, 3), m. Never waits."""
        frame = self._frame
        assert frame is not None  # the first one was waited for
        return frame.number, frame.positions[0].copy()

    def send(self, kind: str, **fields: Any) -> dict[str, Any]:
        """Send a message and wait for its answer. Raises InvalidInput with the reason where it is refused."""
        self._last += 1
        number = self._last
        self._write(json.dumps({"type": kind, "id": number, **fields}))
        if not self._wait(lambda: number in self._answers):
            raise ClothfitError(f"{kind}: no answer came" + (": the connection is closed" if self._closed else ""))
        answer = self._answers.pop(number)
        if answer["type"] == "refused":
            raise InvalidInput(answer["reason"])
        return answer

    def wait_for(self, kind: str, timeout: float | None = None) -> dict[str, Any]:
        """Wait for the next message of a type, such as "ended". Raises ClothfitError where none comes."""
        self.heard.pop(kind, None)
        if not self._wait(lambda: kind in self.heard, timeout):
            raise ClothfitError(f"no message {kind!r} came")
        return self.heard[kind]

    def close(self) -> None:
        """End the connection."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._socket.close, 1000)
            self._wait(lambda: self._closed, CLOSING)
            self._end()

    def _end(self) -> None:
        """End the thread."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _wait(self, done: Callable[[], bool], timeout: float | None = None) -> bool:
        with self._news:
            self._news.wait_for(lambda: done() or self._closed, self.timeout if timeout is None else timeout)
            return done()

    def _write(self, text: str) -> None:
        """Send a text; where the connection is closed, no answer to it comes."""
        if not self._closed:
            asyncio.run_coroutine_threadsafe(self._sent(text), self._loop)

    async def _sent(self, text: str) -> None:
        await self._socket.write_message(text)

    def _take(self, data: str | bytes | None) -> None:
        """Take a message of the server, in the thread; None: the connection has ended."""
        with self._news:
            try:
                self._closed = self._closed or data is None
                if isinstance(data, bytes):
                    packet = wire.unpacked(data)
                    if packet.kind == wire.FRAME:
                        self._frame = packet
                    else:
                        self.target = packet.positions
                elif data is not None:
                    message = json.loads(data)
                    self.heard[message["type"]] = message
                    if message["type"] == "scene":
                        self.scene = message
                    elif message.get("id") is not None:
                        self._answers[message["id"]] = message
            except (ValueError, InvalidInput):  # it is no server of ours
                self._closed = True
            self._news.notify_all()


def connect(address: str, timeout: float = 30.0) -> Connection:
    """Connect to the address that `clothfit serve` printed. Raises InvalidInput where no server answers there."""
    return Connection(address, timeout)


async def opened(address: str, timeout: float, take: Callable[[str | bytes | None], None]) -> Any:
    """The WebSocket at an address, whose messages are given to `take`. Raises InvalidInput."""
    try:
        from tornado import httpclient, websocket
    except ImportError:
        raise InvalidInput("connect needs tornado; install it with: pip install 'clothfit[serve]'") from None
    parts = urlsplit(address)
    if parts.scheme not in ("http", "ws") or not parts.hostname:
        raise InvalidInput(f"{address[:80]!r} is no address that clothfit serve prints")
    place = f"{parts.hostname}:{parts.port or 80}"
    request = httpclient.HTTPRequest(f"ws://{place}/ws?{parts.query}", connect_timeout=timeout, request_timeout=timeout)
    try:
        return await websocket.websocket_connect(request, on_message_callback=take, max_message_size=LARGEST)
    except httpclient.HTTPClientError as error:
        raise InvalidInput(f"{place}: the server refuses: {f'{error.code} {error.message}'[:81]}") from None
    except (OSError, websocket.WebSocketError) as error:
        raise InvalidInput(f"{place}: no server answers ({error})") from None
