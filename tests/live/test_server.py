"""The server: what it answers, what it refuses, and that nobody's faults are felt by others. The attacks are bytes on
plain sockets, of no library.
"""

import base64
import http.client
import json
import os
import socket
import struct
import zlib
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere

from clothfit import ClothfitError, InvalidInput, connect, simulate
from clothfit.scene.scene import dumps, load

pytest.importorskip("tornado")

from clothfit.live.server import Serving

pytestmark = pytest.mark.slow  # starts processes

BALL = sphere(0.5, pos={"x": 1.0, "y": -2.0, "z": 1.0})


def scene(**fields):
    return load(document(cloth(**fields), colliders=[BALL]))


@pytest.fixture(scope="module")
def serving():
    with Serving(scene()) as server:
        yield server


@pytest.fixture
def client(serving):
    with connect(serving.address) as made:
        made.address = serving.address
        made.send("pause")
        made.send("reset")
        yield made


def stepped(client, n):
    """The positions n steps on."""
    client.send("reset")
    shown(client, 0)
    client.send("step", n=n)
    return shown(client, n)


def shown(client, number):
    """The positions of a frame, when it has come."""
    while client.latest()[0] != number:
        with client._news:
            client._news.wait(1.0)
    return client.latest()[1]


def test_a_client_gets_the_scene_and_the_positions_of_every_step(client):
    assert client.scene["mesh"]["vertex_counts"] == [12]
    expected = np.array(scene().cloths[0].positions)
    assert np.abs(client.latest()[1] - expected).max() < 1e-6  # float32 of numbers up to 3
    assert client.send("status")["status"]["running"] is False
    assert np.abs(stepped(client, 20) - simulate(scene(), 21).positions[-1]).max() < 1e-6  # as `simulate` has them


def test_factors_and_values_change_the_motion_and_undo_brings_it_back(client):
    before = stepped(client, 20)
    answer = client.send("set", factors={"stiffness": {"all": 3.0}, "mass": 0.5}, gesture="a")
    assert answer["values"]["factors"][0]["stiffness"]["all"] == 3.0
    found = client.send("elements")["stiffness"]
    told = np.frombuffer(zlib.decompress(base64.b64decode(found["data"])), "<f4")
    assert np.allclose(told, 3 * scene().cloths[0].stiffness, rtol=1e-6)  # float32
    client.send("set", values={"damping": 2.0, "wind": [0, 0, 9]}, gesture="b")
    client.send("set", values={"damping": 3.0}, gesture="b")
    assert np.abs(stepped(client, 20) - before).max() > 0.01
    own = scene().cloths[0]
    saved = load(json.loads(saved_text(client)))
    assert np.allclose(saved.cloths[0].stiffness, 3 * own.stiffness, rtol=1e-15)
    assert np.allclose(saved.cloths[0].mass, own.mass / 2, rtol=1e-15)
    assert saved.cloths[0].damping == 3.0
    for _ in range(2):  # the two gestures
        answer = client.send("undo")
    assert answer["values"]["factors"][0]["stiffness"]["all"] == 1.0
    assert np.array_equal(stepped(client, 20), before)


def saved_text(client):
    """The scene as a download."""
    with urlopen(client.address.replace("/?", "/scene.json?")) as reply:
        return reply.read()


def test_another_scene_has_another_generation_and_is_saved_as_the_text_that_was_loaded(client):
    before = client.scene["generation"]
    client.send("load", scene=document(cloth(3, 3)), name="other.json")
    while client.scene["generation"] == before or client.latest()[1].shape != (9, 3):
        with client._news:
            client._news.wait(1.0)
    assert client.scene["name"] == "other.json"
    client.send("load", scene=dumps(scene()).decode())
    assert saved_text(client) == dumps(scene())


def test_a_long_message_is_read_in_another_process_and_answered_with_its_id(client):
    text = dumps(scene()).decode() + " " * (300 << 10)
    answer = client.send("load", scene=text, name="long.json")
    assert client.scene["name"] == "long.json"
    assert client.scene["generation"] == answer["status"]["generation"]
    with pytest.raises(InvalidInput, match="too large"):
        client.send("play", speed="x" * (300 << 10))


def test_a_client_that_reads_nothing_is_cut_off(serving, client):
    parts = urlsplit(serving.address)
    with socket.create_connection((parts.hostname, parts.port), 30) as made:
        made.sendall(handshake(serving.address))
        assert made.recv(12) == b"HTTP/1.1 101"
        client._wait(lambda: len(serving.server.clients) == 2)
        for _ in range(60):  # the other client takes each before the next: else it might be cut off itself
            client.heard.pop("news", None)
            serving.server.send_all({"type": "news", "text": "x" * (1 << 20)})
            assert client._wait(lambda: "news" in client.heard)
        while len(serving.server.clients) > 1:
            assert client.send("status")["type"] == "done"


def test_a_fit_is_run_beside_and_its_values_are_taken(client):
    client.send("load", scene=dumps(scene()).decode())
    while client.target is None or client.send("status")["status"]["busy"]:
        client.wait_for("status")
    client.send("set", factors={"stiffness": 2.0})
    client.send("estimate", fit={"stiffness": "F"})
    ended = client.wait_for("ended", 300)
    assert ended["status"] == "converged"
    assert ended["rmse"] < 1e-7
    found = load(json.loads(saved_text(client))).cloths[0].stiffness
    assert np.allclose(found, scene().cloths[0].stiffness, rtol=1e-6)
    for factor in (2, 1):  # before the fit, and as it was loaded
        client.send("undo")
        back = load(json.loads(saved_text(client))).cloths[0].stiffness
        assert np.allclose(back, factor * scene().cloths[0].stiffness, rtol=1e-12)


@pytest.mark.parametrize(
    ("kind", "fields", "said"),
    [
        ("dance", {}, "there is no message 'dance'"),
        ("play", {"tempo": 3}, "there is no field 'tempo'"),
        ("play", {"speed": 0}, "speed"),
        ("step", {"n": 0}, "from 1 to 1000"),
        ("step", {"n": True}, "from 1 to 1000"),
        ("set", {}, "values"),
        ("set", {"values": {"of": 0}}, "`of` is no value"),
        ("set", {"values": {"mass": -1}}, "above 0"),
        ("set", {"factors": {"mass": {"all": -1}}}, "a number from"),
        ("set", {"factors": {"mass": {"sleeve": 2}}}, "no group 'sleeve'"),
        ("set", {"factors": {"colour": 2}}, "mass and stiffness"),
        ("set", {"values": {"damping": 1}, "object": 4}, "object"),
        ("set", {"values": {"colliders": {"0": {"pos": [0, 0]}}}}, "three numbers"),
        ("drag", {"vertex": 12, "place": [0, 0, 0]}, "no vertex 12"),
        ("drag", {"vertex": 0, "place": "up"}, "three numbers"),
        ("drag", {"vertex": 0, "place": [0, 0, 1e300]}, "too far"),
        ("load", {}, "`scene` is needed"),
        ("load", {"scene": {}}, "integrationMethod: is missing"),
        ("load", {"scene": "[[["}, "scene"),
        ("estimate", {"fit": {"colour": "L"}}, "fit"),
        ("estimate", {"fit": {"mass": "n"}}, "nothing is chosen"),
        ("control", {"keys": [{"time": 1.0, "vertices": [99], "positions": [[0, 0, 0]]}]}, "no such vertex"),
        ("control", {"keys": [{"time": 1e11, "vertices": [1], "positions": [[0, 0, 0]]}]}, "too many steps"),
        ("cancel", {}, "nothing is being computed"),
    ],
)
def test_what_cannot_be_done_is_refused_with_the_reason(client, kind, fields, said):
    if kind == "estimate":
        while client.target is None:
            client.wait_for("status")
    with pytest.raises(InvalidInput, match=said):
        client.send(kind, **fields)
    assert client.send("status")["type"] == "done"


def asked(host, port, data):
    """The reply to some bytes."""
    with socket.create_connection((host, port), 30) as made:
        made.sendall(data)
        reply = http.client.HTTPResponse(made)
        reply.begin()
        head = f"HTTP/1.1 {reply.status} {reply.reason}\r\n{reply.headers}".encode()
        return head, reply.read()


def handshake(address, path="/ws", host=None, origin=None, token=None):
    parts = urlsplit(address)
    query = parts.query if token is None else token
    lines = [f"GET {path}?{query} HTTP/1.1", f"Host: {host or parts.netloc}", "Upgrade: websocket",
             "Connection: Upgrade, close", "Sec-WebSocket-Key: " + base64.b64encode(os.urandom(16)).decode(),
             "Sec-WebSocket-Version: 13"]  # fmt: skip
    if origin is not None:
        lines.append(f"Origin: {origin}")
    return "\r\n".join([*lines, "", ""]).encode()


@pytest.mark.parametrize("path", ["/", "/ws", "/scene.json", "/nothing"])
@pytest.mark.parametrize(
    "fields",
    [{"token": ""}, {"token": "token="}, {"token": "token=" + "A" * 24}, {"token": "token=%00%ff"},
     {"origin": "https://example.org"}, {"origin": "null"}, {"origin": "http://127.0.0.1:1"}, {"host": "example.org"},
     {"host": "127.0.0.1:1"}],
    ids=range(9),
)  # fmt: skip
def test_strangers_are_refused(serving, path, fields):
    parts = urlsplit(serving.address)
    reply = asked(parts.hostname, parts.port, handshake(serving.address, path, **fields))
    assert reply[0].split(b" ", 2)[1] in (b"403", b"400")
    assert b"importmap" not in reply[1]


def test_the_page_lets_nothing_else_load(serving):
    parts = urlsplit(serving.address)
    head, body = asked(parts.hostname, parts.port, handshake(serving.address, "/"))
    assert head.startswith(b"HTTP/1.1 200")
    assert b"default-src 'none'" in head
    assert b"frame-ancestors 'none'" in head
    assert b"Referrer-Policy: no-referrer" in head
    assert b"importmap" in body


def frame(code, data):
    """A frame of RFC 6455, masked."""
    return bytes([0x80 | code]) + struct.pack("!BH", 0xFE, len(data)) + bytes(4) + data


ATTACKS = {  # frames that are wrong themselves are tornado's
    "no message": frame(1, b"hello"),
    "no text": frame(1, b"\xff\xfe\xfd"),
    "binary": frame(2, bytes(1000)),
    "deep": frame(1, b'{"type":' + b"[" * 60000),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_a_broken_message_costs_its_sender_only(serving, client, name):
    parts = urlsplit(serving.address)
    for _ in range(5):
        with socket.create_connection((parts.hostname, parts.port), 30) as made:
            made.sendall(handshake(serving.address))
            assert made.recv(12) == b"HTTP/1.1 101"
            made.sendall(ATTACKS[name])
            made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # gone without a word
    assert client.send("status")["type"] == "done"


def test_too_many_messages_are_refused_and_others_are_answered(serving, client):
    with connect(serving.address) as flood:
        for _ in range(1500):
            flood._write('{"type":"status"}')
        assert flood._wait(lambda: "refused" in flood.heard, 60)
        assert "too many messages" in flood.heard["refused"]["reason"]
        assert client.send("status")["type"] == "done"


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("ftp://{host}/?token={token}", "is no address that clothfit serve prints"),
        ("http://{host}/?token=x{token}", "the server refuses: 403 The token is missing or wrong"),
        ("http://127.0.0.1:1/?token={token}", "127.0.0.1:1: no server answers"),
    ],
)
def test_where_no_server_answers_a_client_says_why(serving, address, said):
    with pytest.raises(InvalidInput, match=said):
        connect(address.format(host=urlsplit(serving.address).netloc, token=serving.server.token), 5.0)


def test_a_closed_connection_answers_nothing(serving):
    with connect(serving.address) as made:
        pass
    with pytest.raises(ClothfitError, match="no answer came: the connection is closed"):
        made.send("status")


def test_a_taken_port_is_said(serving):
    with pytest.raises(InvalidInput, match=f"port {serving.server.port}: "):
        Serving(scene(), port=serving.server.port)
