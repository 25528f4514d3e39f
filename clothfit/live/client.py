"""A client of `clothfit serve` in Python, without packages beside NumPy.

A thread reads what the server sends and keeps the newest frame, so that `latest` never waits. The frames of the
WebSocket are those of RFC 6455.
"""

from __future__ import annotations

import base64
import json
import os
import socket
import struct
import threading
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live import wire

TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10


class Connection:
    """A connection to a server; `connect` makes one. Use it in a `with` block, or call `close`."""

    def __init__(self, address: str, timeout: float) -> None:
        self.timeout, self._closed = timeout, False
        self._socket = opened(address, timeout)
        self._lock, self._news = threading.Lock(), threading.Condition()
        self._frame: wire.Packet | None = None
        self._answers: dict[int, dict[str, Any]] = {}
        self._last = 0
        self.target: Array | None = None  # (frames, n, 3), m
        self.scene: dict[str, Any] = {}  # as docs/serve.md describes it
        self.heard: dict[str, dict[str, Any]] = {}  # the last message of each type
        self._thread = threading.Thread(target=self._listen, name="clothfit client", daemon=True)
        self._thread.start()
        if not self._wait(lambda: bool(self.scene) and self._frame is not None):
            self.close()
            raise InvalidInput(f"{address.partition('?')[0]}: the server sends no scene")

    def __enter__(self) -> Connection:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        self._write(TEXT, json.dumps({"type": kind, "id": number, **fields}).encode())
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
        if not self._closed:
            self._write(CLOSE, struct.pack("!H", 1000))
        self._end()

    def _end(self) -> None:
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._socket.close()

    def _wait(self, done: Any, timeout: float | None = None) -> bool:
        with self._news:
            self._news.wait_for(lambda: done() or self._closed, self.timeout if timeout is None else timeout)
            return bool(done())

    def _write(self, code: int, data: bytes) -> None:
        mask = os.urandom(4)
        size = len(data)
        head = bytes([0x80 | code])
        if size < 126:
            head += bytes([0x80 | size])
        else:
            head += bytes([0xFE]) + struct.pack("!H", size) if size < 1 << 16 else b"\xff" + struct.pack("!Q", size)
        padded = np.frombuffer(data + bytes(-size % 4), np.uint32) ^ np.frombuffer(mask, np.uint32)
        try:
            with self._lock:
                self._socket.sendall(head + mask + padded.tobytes()[:size])
        except OSError:
            self._end()

    def _listen(self) -> None:
        parts: list[bytes] = []
        kind = TEXT
        try:
            while not self._closed:
                first, second = self._read(2)
                size = second & 127
                if size > 125:
                    (size,) = struct.unpack("!H" if size == 126 else "!Q", self._read(2 if size == 126 else 8))
                if size > 1 << 30:
                    break
                data, code = self._read(size), first & 15
                if code == PING:
                    self._write(PONG, data)
                elif code == CLOSE:
                    break
                elif code != PONG:
                    kind = code or kind
                    parts.append(data)
                    if first & 0x80:
                        whole, parts = b"".join(parts), []
                        self._take(kind, whole)
        except (OSError, ValueError, InvalidInput):
            pass
        self._end()

    def _read(self, size: int) -> bytes:
        found = bytearray()
        while len(found) < size:
            try:
                more = self._socket.recv(min(size - len(found), 1 << 20))
            except TimeoutError:
                continue
            if not more:
                raise OSError("the connection has ended")
            found += more
        return bytes(found)

    def _take(self, kind: int, data: bytes) -> None:
        with self._news:
            if kind == BINARY:
                packet = wire.unpacked(data)
                if packet.kind == wire.FRAME:
                    self._frame = packet
                else:
                    self.target = packet.positions
            else:
                message = json.loads(data)
                self.heard[message["type"]] = message
                if message["type"] == "scene":
                    self.scene = message
                elif message.get("id") is not None:
                    self._answers[message["id"]] = message
            self._news.notify_all()


def connect(address: str, timeout: float = 30.0) -> Connection:
    """Connect to the address that `clothfit serve` printed. Raises InvalidInput where no server answers there."""
    return Connection(address, timeout)


def opened(address: str, timeout: float) -> socket.socket:
    """The socket of a WebSocket at an address. Raises InvalidInput."""
    parts = urlsplit(address)
    host, port = parts.hostname or "", parts.port or 80
    if parts.scheme not in ("http", "ws") or not host:
        raise InvalidInput(f"{address[:80]!r} is no address that clothfit serve prints")
    key = base64.b64encode(os.urandom(16)).decode()
    try:
        made = socket.create_connection((host, port), timeout)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        lines = [
            f"GET /ws?{parts.query} HTTP/1.1", f"Host: {host}:{port}", "Upgrade: websocket", "Connection: Upgrade",
            f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13",
        ]  # fmt: skip
        made.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        head = b""
        while not head.endswith(b"\r\n\r\n") and len(head) < 1 << 14:
            more = made.recv(1)
            if not more:
                break
            head += more
    except OSError as error:
        raise InvalidInput(f"{host}:{port}: no server answers ({error})") from None
    status = head.split(b"\r\n", 1)[0].decode(errors="replace")
    if " 101 " not in status:
        made.close()
        raise InvalidInput(f"{host}:{port}: the server refuses: {status[9:90]}")
    return made
