"""Mutations of valid scenes and motions: of their values, of their structure, and of the bytes they are written as.

Each takes a `random.Random` and gives bytes; the same seed gives the same bytes.
"""

import codecs
import copy
import io
import json
import math
import struct
import warnings
import zipfile
from collections.abc import Callable
from functools import partial
from random import Random
from typing import Any

import numpy as np
from helpers.files import damaged, places
from helpers.scenes import cloth, document, sphere

NUMBERS = [
    0, -0.0, 1, -1, 2, 3, 0.5, 1e-5, 1e300, -1e300, 1e-300, 5e-324, 1.7e308, 1e154, 1e-160, 1e12, 1e19, 2**31 - 1,
    2**31, 2**32, 2**53 + 1, 2**63, 2**64, 10**30, -(2**31), math.nan, math.inf, -math.inf,
]  # fmt: skip
OTHERS = [None, True, False, "", "nn", "GL", "lg", "\0", "\ud800", "é" * 50, [], {}, [[]], [{}], {"x": 1}, "NaN", "1"]
TOKENS = [
    b"1e999", b"-1e999", b"1e-999", b"-0", b"9" * 10_000, b"0." + b"3" * 5_000, b"1e+", b"01", b"NaN", b"-Infinity",
    b"0x10", b".5", b"+1", b"1_0", b"tru", b"[" * 70, b'{"a":' * 70, b'"', b"\\", b"\0", b"\xff", b"\xef\xbb\xbf", b",",
    b'"\\ud800"', b"\xed\xa0\x80", b"//", b"'", b"\x1a", b"]", b"}", b":",
]  # fmt: skip
CODECS = ["utf-16", "utf-32", "utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be", "utf-8-sig", "utf-7", "cp1252"]
MARKS = [codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE]
DTYPES = ["f2", "f4", ">f8", "f8", "i1", "i4", ">i8", "u8", "b1", "c16", "U3", "S3", "V8", "M8[s]", "m8[ns]", "f16"]
DESCRS = ["|O", "<f8", "V99999999999", "S2147483647", "f99", "M8[x]", "", "<f8, <f8", "(9,3)f8", "\\x00"]
SHAPES = [
    (2**60, 9, 3), (-1, 9, 3), (0, 9, 3), (4, 9, 3), (10**30,), (), (2**32,) * 4, (1,) * 70, (10**8, 9, 3), (4, 9),
    (4,), (0, 10**30, 3),
]  # fmt: skip


def scene() -> dict[str, Any]:
    """A valid scene with every field there is: two small cloths, a sphere and a plane."""
    zeros = [{"x": 0.0, "y": 0.1, "z": 0.0}] * 9
    one = cloth(3, 3, optimizationSettings="LL", vertVel=zeros, fit={"damping": "G", "vertVel": "L"})
    two = cloth(2, 2, optimizationSettings="nG", springRestLength=[0.9] * 5)
    wind, fall = {"x": 1.0, "y": 0.0, "z": 2.0}, {"x": 0.0, "y": -9.81, "z": 0.0}
    colliders = [sphere(), sphere(type=0)]
    return document(
        one, two, optimizationIterations=4, windVel=wind, gravity=fall, colliders=colliders, fit={"windVel": "G"}
    )


def motion() -> dict[str, np.ndarray]:
    """The arrays of a valid motion of that scene at rest, every one there is."""
    points = [[p["x"], p["y"], p["z"]] for each in scene()["objects"] for p in each["vertPos"]]
    observed = np.ones((4, 13), bool)
    observed[2, 5] = False
    return {
        "positions": np.tile(np.array(points), (4, 1, 1)),
        "times": 0.02 * np.arange(4),
        "vertex_counts": np.array([9, 4]),
        "observed": observed,
        "weights": np.ones(13),
    }


KEYED = "keys.csv"
"""The file of some of the keys."""

TABLE = "time,x,y,z\n0,0,0.1,0\n0.02,1,-0.5,2\n0.1,0,3,-1\n"
"""What is in it."""


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    """A vector."""
    return {"x": x, "y": y, "z": z}


def keyed(*values: tuple[float, float, float], **fields: Any) -> dict[str, Any]:
    """Keys 0.02 s apart."""
    return {"times": [0.02 * i for i in range(len(values))], "values": [xyz(*value) for value in values], **fields}


def tetrahedron() -> dict[str, Any]:
    """A closed mesh."""
    points = [xyz(0, 0, 0), xyz(1, 0, 0), xyz(0, 1, 0), xyz(0, 0, 1)]
    return {"vertices": points, "triangles": [0, 1, 2, 0, 2, 3, 0, 3, 1, 1, 3, 2]}


def colliders() -> list[dict[str, Any]]:
    """One of each shape."""
    zero = xyz(0, 0, 0)
    moved, turned = keyed((0, 0, 0), (0.1, 0.2, 0), interpolation="smooth"), keyed((0, 0, 0), (10, 50, -20))
    law = {"friction": 0.4, "stiffness": 800, "thickness": 0.02}
    turn = {"rot": xyz(0, 20, 5), "rotKeys": turned}
    return [
        {**sphere(), "posKeys": moved},
        {**sphere(), "posKeys": {"file": KEYED}, **law},
        {"type": 0, "pos": xyz(0, -0.3, 0), "scale": xyz(1, 1, 1), **turn, **law},
        {"type": 2, "pos": zero, "scale": xyz(1, 1, 1), "radius": 0.2, "radius2": 0.3, "height": 0.6, **turn, **law},
        {"type": 3, "pos": xyz(0, -0.1, 0), "scale": xyz(0.8, 0.4, 1), "posKeys": moved, **turn, **law},
        {"type": 4, "pos": xyz(0.5, -0.5, 0), "scale": xyz(0.5, 1, 1), "mesh": tetrahedron(), "posKeys": moved, **law},
    ]


def moving() -> dict[str, Any]:
    """A valid scene in which everything moves that can: two small cloths, as many vertices as `scene`."""
    pins = [
        {"vertices": [0], "posKeys": keyed((0, 0, 0), (0.01, 0, 0.02), interpolation="hold")},
        {"vertices": [2], "rotKeys": keyed((0, 0, 0), (5, 9, 1)), "pivot": xyz(1, 0, 0), "posKeys": {"file": KEYED}},
    ]
    one = cloth(3, 3, optimizationSettings="nF", pins=pins)
    return document(
        one, cloth(2, 2), optimizationIterations=4, windVelKeys=keyed((0, 0, 0), (1, 2, 3)),
        gravityKeys={"file": KEYED, "interpolation": "smooth"}, planes="solid", colliders=colliders(),
        colliderOffset=xyz(0.01, 0, -0.02),
        frame={"posKeys": keyed((0, 0, 0), (0.1, 0, 0.3), (0, 0, 0), interpolation="smooth")},
        fit={
            "windVelKeys": "L", "friction": "L", "contact": "G", "colliderOffset": True, "bounds": {"friction": [0, 2]},
        },
    )  # fmt: skip


def changed_document(chance: Random, valid: Callable[[], dict[str, Any]]) -> Any:
    """A scene that was `valid`, with one to three of its values replaced, taken away, repeated or exchanged."""
    made = copy.deepcopy(valid())
    for _ in range(chance.choice([1, 1, 1, 2, 3])):
        found = places(made)
        if not found:
            break
        # long lists would take nearly all: first a kind of place, then one of these
        kinds = sorted({str([step for step in path if isinstance(step, str)]) for path in found})
        kind = chance.choice(kinds)
        path = chance.choice([p for p in found if str([step for step in p if isinstance(step, str)]) == kind])
        owner = made
        for step in path[:-1]:
            owner = owner[step]
        alter(chance, owner, path[-1])
    return made


def alter(chance: Random, owner: Any, key: Any) -> None:
    """Change one member of a list or an object."""
    value = owner[key]
    match chance.randrange(8):
        case 0:
            owner[key] = copy.deepcopy(chance.choice(OTHERS))
        case 1:
            del owner[key]
        case 2 if isinstance(owner, list):
            owner[key:key] = [copy.deepcopy(value) for _ in range(chance.choice([1, 2, 3, 100]))]
        case 3 if isinstance(owner, dict):
            name = chance.choice(["", "x", "delta", "vertPos", "a b", "\0", "é"])
            owner[name] = copy.deepcopy(chance.choice([*NUMBERS, *OTHERS]))
        case 4 if isinstance(owner, list):
            chance.shuffle(owner)
        case _:
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            near = [value * 1e3, value / 1e3, -value, value + 1, value - 1, float(value)] if number else []
            owner[key] = chance.choice([*NUMBERS, *near, *near])


def scene_bytes(chance: Random, valid: Callable[[], dict[str, Any]] = scene) -> bytes:
    """A `valid` scene that is changed in its values, as a text, or both."""
    text = json.dumps(changed_document(chance, valid) if chance.random() < 0.75 else valid())
    data = text.encode("utf-8", "surrogatepass")
    match chance.randrange(10):
        case 0 | 1:
            return with_token(chance, data)
        case 2:
            return damaged(data, chance)
        case 3:
            return text.encode(chance.choice(CODECS), "replace")
        case 4:
            return chance.choice(MARKS) + data
    return data


def with_token(chance: Random, data: bytes) -> bytes:
    """A text with some token in the place of another."""
    starts = [i for i, byte in enumerate(data) if byte in b" ,:[{"]
    at = chance.choice(starts) + 1 if starts else 0
    end = at
    while end < len(data) and data[end] not in b" ,:]}[{":
        end += 1
    token = chance.choice([*TOKENS, data[at : at + chance.randrange(100)]])
    return data[:at] + token + data[end if chance.random() < 0.8 else at :]


def text_bytes(chance: Random, data: bytes) -> bytes:
    """A text, such as a table of keys, with another word in it, or damaged."""
    return with_token(chance, data) if chance.random() < 0.6 else damaged(data, chance)


def array(chance: Random, value: np.ndarray) -> np.ndarray:
    """An array of another type, shape or order, or with other numbers."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what complex numbers lose
        match chance.randrange(7):
            case 0:
                return value.astype(chance.choice(DTYPES))
            case 1:
                return value[: chance.randrange(len(value) + 1)]
            case 2:
                return np.asfortranarray(value) if chance.random() < 0.5 else value.T
            case 3:
                return value.reshape(-1)
            case 4:
                return np.repeat(value, 2, axis=chance.randrange(value.ndim))
            case _:
                made = value.astype(float)
                for _ in range(chance.choice([1, 1, 3])):
                    made.reshape(-1)[chance.randrange(made.size)] = float(chance.choice(NUMBERS))
                return made if chance.random() < 0.7 else made.astype(value.dtype)


def npy(value: np.ndarray) -> bytes:
    """The bytes of an array."""
    file = io.BytesIO()
    np.lib.format.write_array(file, value, allow_pickle=True)
    return file.getvalue()


def npy_bytes(chance: Random, value: np.ndarray) -> bytes:
    """The bytes of an array whose header or numbers may be wrong."""
    data = npy(value)
    if chance.random() < 0.6:
        return data
    if chance.random() < 0.4:
        return damaged(data, chance)
    shape, descr = chance.choice([*SHAPES, value.shape]), chance.choice([*DESCRS, "<f8"])
    text = f"{{'descr': {descr!r}, 'fortran_order': {chance.random() < 0.5}, 'shape': {shape}, }}"
    text = chance.choice([text, text, text, text * 2, "(" * 5000, "-" * 9000, "[" * 60_000, "9**9**9", ""])
    header = text.encode()
    length = chance.choice([len(header), len(header), len(header), 0, 2**16 - 1, 2**32 - 1])
    start = b"\x93NUMPY\2\0" + struct.pack("<I", length)
    if chance.random() < 0.5:
        start = b"\x93NUMPY\1\0" + struct.pack("<H", length % 2**16)
    return start + header + data[-value.nbytes :]


def zipped(chance: Random, members: list[tuple[str, bytes]]) -> bytes:
    """An archive of some members."""
    file = io.BytesIO()
    methods = [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]
    method = chance.choice(methods)
    with zipfile.ZipFile(file, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that are there twice
        for name, data in members:
            archive.writestr(zipfile.ZipInfo(name), data, method)  # as of 1980, so that the bytes are always the same
    return file.getvalue()


def motion_bytes(chance: Random) -> bytes:
    """A motion that is changed in its arrays, their files, or the archive."""
    arrays = motion()
    for name in [key for key in arrays if chance.random() < 0.2 and key != "positions"]:
        del arrays[name]
    for _ in range(chance.choice([0, 1, 1, 2])):
        name = chance.choice(sorted(arrays))
        if arrays[name].size and arrays[name].dtype.kind in "fiub":
            arrays[name] = array(chance, arrays[name])
    whole = chance.random() < 0.5
    members = [(f"{name}.npy", npy(value) if whole else npy_bytes(chance, value)) for name, value in arrays.items()]
    if chance.random() < 0.1:
        members.append(chance.choice([*members, ("other.npy", b"x"), ("positions", b""), ("../times.npy", b"")]))
    data = members[0][1] if chance.random() < 0.1 else zipped(chance, members)
    return damaged(data, chance) if chance.random() < 0.3 else data


KINDS: dict[str, Callable[[Random], bytes]] = {
    "scene": scene_bytes, "moving": partial(scene_bytes, valid=moving), "motion": motion_bytes,
    "keys": partial(text_bytes, data=TABLE.encode()),
}  # fmt: skip
