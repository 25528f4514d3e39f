"""Files for tests: those of other programs as bytes, read and written; hostile bytes of any."""

import io
from random import Random
from typing import Any

import numpy as np

from clothfit.formats.animation import Animation
from clothfit.formats.registry import foreign, module_of


class Stream(io.RawIOBase):
    """A device that gives some bytes, a `piece` at a time or as many as are asked for, then zeros without end where it
    is `endless`; it notes how many.
    """

    def __init__(self, data: Any, piece: int | None = None, endless: bool = True) -> None:
        self.data, self.piece, self.endless, self.given = data, piece, endless, 0

    def read(self, size: int = -1) -> Any:
        size = self.piece or size
        found = self.data[self.given : self.given + size]
        found = found.ljust(size, b"\0") if self.endless else found
        self.given += len(found)
        return found


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
    """Bytes with some of them changed, lost, repeated, put in or another word; or the end lost."""
    made = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 5])):
        at = chance.randrange(min(len(made), chance.choice([1024, len(made)])) + 1)
        length = chance.choice([1, 1, 2, 4, 8, 100])
        match chance.randrange(9):
            case 0 if at < len(made):
                made[at] ^= 1 << chance.randrange(8)
            case 1:
                del made[at : at + length]
            case 2:
                made[at:at] = made[at : at + length]
            case 3:
                made[at : at + length] = chance.randbytes(length)
            case 4:
                number = chance.choice([0, 1, 2**31, 2**32 - 1, 0xFFFF, len(made)])
                made[at : at + 4] = number.to_bytes(4, "little")
            case 5:
                number = chance.choice([0, 2**63, 2**64 - 1, chance.randrange(len(made) + 1)])
                made[at : at + 8] = number.to_bytes(8, "little")
            case 6:
                made[at : at + chance.choice([0, 1, 3])] = chance.choice(WORDS)
            case 7:
                other = chance.randrange(len(made) + 1)
                made[at : at + 20] = made[other : other + chance.randrange(20)]
            case _:
                del made[at:]
    return bytes(made)


def places(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """The paths of all values in a document but itself."""
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [inner for key, item in members for inner in [(*path, key), *places(item, (*path, key))]]


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    """The values of a document that hold no others, by their paths; numbers with a point as float32."""
    if isinstance(value, dict):
        return {k: v for name, each in value.items() for k, v in leaves(each, f"{path}.{name}").items()}
    if isinstance(value, list):
        return {k: v for i, each in enumerate(value) for k, v in leaves(each, f"{path}[{i}]").items()}
    return {path: np.float32(value) if isinstance(value, float) else value}
