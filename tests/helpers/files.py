"""Files of other programs for tests: read and written as bytes, and damaged."""

from __future__ import annotations

import io
from random import Random
from typing import Any

from clothfit.formats.animation import Animation
from clothfit.formats.registry import foreign, module_of

WORDS = [b"0", b"-1", b"1e308", b"99999999999", b"nan", b'"', b"\n", b"\t", b",", b";", b"\xff", b"#", b""]


def read(folder: Any, name: str, data: bytes | str) -> Animation:
    """What the reader of its suffix, of whatever size, finds in a file of that name."""
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    found: Animation = module_of(foreign(name)).read(folder / name)
    return found


def written(name: str, animation: Animation) -> bytes:
    """The bytes of a file of one animation."""
    (data,) = module_of(foreign(name)).encoded(name, animation).values()
    if isinstance(data, bytes):
        return data
    file = io.BytesIO()
    data(file)
    return file.getvalue()


def damaged(data: bytes, chance: Random) -> bytes:
    """A file that is cut off, or has other bytes, another word, a number that is another place, or a part twice."""
    kind, place = chance.randrange(5), chance.randrange(len(data))
    changed = bytearray(data)
    if kind == 0:
        return data[:place]
    if kind == 1:
        for _ in range(chance.choice([1, 2, 5])):
            at = chance.randrange(min(len(data), chance.choice([1024, len(data)])))
            changed[at] = chance.choice([0, 127, 128, 255, chance.randrange(256)])
    elif kind == 2:
        changed[place : place + chance.choice([0, 1, 3])] = chance.choice(WORDS)
    elif kind == 3:
        number = chance.choice([0, 2**31, 2**63, 2**64 - 1, chance.randrange(len(data))])
        changed[place : place + 8] = number.to_bytes(8, "little")
    else:
        other = chance.randrange(len(data))
        changed[place : place + 20] = changed[other : other + chance.randrange(20)]
    return bytes(changed)
