"""The layout of frames, as docs/serve.md gives it to those who write clients, and messages that are read."""

import struct

import numpy as np
import pytest

from clothfit.base.errors import InvalidInput
from clothfit.live import wire


def test_a_frame_and_a_target_are_what_the_documents_say():
    x = np.array([[1.0, -2.0, 0.5], [3.0, 4.0, 1e300]])
    data = wire.packed(wire.FRAME, 7, 1 << 40, 0.25, x)
    assert data[:4] == b"CFF1"
    assert struct.unpack_from("<IQd", data, 4) == (7, 1 << 40, 0.25)
    assert np.frombuffer(data[24:], "<f4").tolist() == [1.0, -2.0, 0.5, 3.0, 4.0, np.inf]
    back = wire.unpacked(data)
    assert back[:4] == (b"CFF1", 7, 1 << 40, 0.25)
    assert np.array_equal(back.positions[0, :, 0], x[:, 0])
    x = np.arange(24.0).reshape(4, 2, 3)  # of a target all frames
    assert np.array_equal(wire.unpacked(wire.packed(wire.TARGET, 1, 4, 0.02, x)).positions, x)


@pytest.mark.parametrize("data", [b"", b"CFF1", b"CFF2" + bytes(32), b"CFF1" + bytes(21), b"CFT1" + bytes(20 + 12)])
def test_other_bytes_are_no_positions(data):
    with pytest.raises(InvalidInput, match="no message of positions"):
        wire.unpacked(data)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no JSON"),
        ("play", "no JSON"),
        ("[" * 100_000, "nested too deeply"),
        ('{"type": "play"} {}', "no JSON"),
        ("[1, 2]", "JSON object"),
        ("{}", 'no "type"'),
        ('{"type": 3}', 'no "type"'),
        ('{"type": "play", "speed": NaN}', "not a number of JSON"),
        ('{"type": "play", "speed": ' + "9" * 5000 + "}", "no JSON"),
        ('{"type": "play", "id": []}', '"id"'),
        ('{"type": "set", "values": {"wind": [' + "0," * 200_000 + "0]}}", "too large"),
        (b"\x00\x01", "binary"),
    ],
    ids=range(12),
)
def test_what_is_no_message_is_refused_with_the_reason(text, said):
    with pytest.raises(InvalidInput, match=said):
        wire.parsed(text)
