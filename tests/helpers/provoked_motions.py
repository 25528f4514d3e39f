"""What provokes the errors of motions of other programs, by their message; see `provoked`."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np

from clothfit.formats.animation import Animation
from clothfit.formats.axes import SCENE
from clothfit.scene.scene import load
from helpers.provoked import VERTICES, Case, patched, raising
from helpers.scenes import trial

START = load(trial("nG", 5)).cloths[0].positions
CORNER = b"v 0 0 0\n"
TRIANGLE = CORNER + b"v 1 0 0\nv 0 0 1\nf 1 2 3\n"
PC2 = struct.pack("<12siiffi3f", b"POINTCACHE2\0", 1, 1, 0, 1, 1, 0, 0, 0)
MDD = struct.pack(">ii2f6f", 2, 1, 0, 1, *range(6))
GAPS = {"positions": np.full((1, 2, 3), np.nan), "times": np.zeros(1), "observed": np.zeros((1, 2), bool)}


def fitted(name: str, options: str = "", **files: Any) -> Case:
    """A fit to a file."""
    return Case(f"estimate scene.json --target '{name}' {options}", files)


def converted(arguments: str, **files: Any) -> Case:
    """A conversion."""
    return Case(f"convert {arguments}", files)


def obj(data: bytes) -> Case:
    """The conversion of an OBJ file with that text."""
    return converted("a.obj b.pc2", **{"a.obj": data})


def sequence(first: bytes, second: bytes, other: str = "a2.obj") -> Case:
    """The conversion of a sequence of two frames."""
    return converted("'a*.obj' b.pc2", **{"a1.obj": first, other: second})


def cache(data: bytes, name: str = "a.pc2") -> Case:
    """The conversion of a point cache with those bytes."""
    return converted(f"{name} b.obj", **{name: data})


def captured(options: str = "", seen: bool = True, **files: Any) -> Case:
    """A fit to two markers at the first two vertices; from a file that is not really there."""
    positions = np.where(seen, START[None, :2], np.nan)
    read = Animation(positions, SCENE, names=("a", "b"))
    case = fitted("a.trc", options, **files)
    module = SimpleNamespace(read=lambda path: read)
    return patched(case, "clothfit.motion.foreign.module_of", lambda found: module)


def mapped(text: str) -> Case:
    """The same with a map."""
    return captured("--map map.csv", **{"map.csv": text.encode("utf-8", "surrogateescape")})


COMMANDS: dict[str, Case] = {
    "no motion format has that suffix; known are …": converted("good.npz a.txt"),
    "--scale, --up, --handedness, --fps, --frames and --map are about the motion of --target; add that": Case(
        "estimate scene.json --up z"
    ),
    "… needs …; install it with: pip install 'clothfit[…]'": patched(
        Case("simulate scene.json -o a.usd"), "clothfit.formats.registry.import_module", raising(ImportError())
    ),
    "is a folder; a file with a motion is needed": fitted("a.obj", **{"a.obj/b.obj": CORNER}),
    "has no points": converted("empty.npz a.pc2", **{"empty.npz": {"positions": np.zeros((2, 0, 3))}}),
    "has … vertices, … has …; a motion needs all vertices of all objects, in their order: export it from the mesh that "
    "the scene was made of": fitted("a.obj", **{"a.obj": CORNER}),
    "has …, none of which is in --frames …": fitted("good.npz", "--frames 9:"),
    "frames: … is not A:B, such as 0:100, 50: or :-1 (B is left out)": fitted("good.npz", "--frames 9"),
    "… has no place for positions that were not seen; write one of …": converted(
        "gaps.npz a.pc2", **{"gaps.npz": GAPS}
    ),
    ".npz has the scene's axes and metres; leave --scale, --up, --handedness out": Case(
        "simulate scene.json -o a.npz --up z"
    ),
    "--mesh: … has no faces": converted("good.npz a.pc2 --mesh a.obj", **{"a.obj": CORNER}),
    "--mesh: … has … vertices, the motion has …": converted("good.npz a.pc2 --mesh a.obj", **{"a.obj": TRIANGLE}),
    "cannot write …: it is an input, which is never written over; name another": converted(
        "a_0000.obj 'a_*.obj'", **{"a_0000.obj": TRIANGLE}
    ),
    "cannot write …: … is there, which would be read as a frame of it; take that away, or choose another name": Case(
        "simulate scene.json -o 'a_*.obj'", {"a_0005.obj": TRIANGLE}
    ),
    "has no vertices (lines v x y z); is it an OBJ file?": obj(b"\x89PNG\r\n"),
    "line …: a vertex needs three finite numbers": obj(b"v 1 2\n"),
    "a face needs three corners or more, each one of … vertices": obj(CORNER + b"f 1 2 3\n"),
    "has … vertices, …, as all frames need": sequence(TRIANGLE, CORNER),
    "has other faces than …; is it of another mesh?": sequence(TRIANGLE, TRIANGLE + b"f 1 2 3\n"),
    "a sequence has one …, in the name of its files, in place of their numbers": fitted("a*/b.obj"),
    "there is no file of that name with a number in place of …": fitted("a*.obj"),
    "… are both frame …; remove one": sequence(CORNER, CORNER, "a01.obj"),
    "a frame is missing after number …": converted(
        "'a*.obj' b.pc2", **{f"a{number}.obj": CORNER for number in (1, 2, 4)}
    ),
    "holds one frame, there are …; write …_…": Case("simulate scene.json -o a.obj"),
    "does not begin as a PC2 point cache does (POINTCACHE2)": cache(b"POINTCACHE3"),
    "is of version … of PC2, 1 can be read": cache(PC2[:12] + b"\2" + PC2[13:]),
    "ends within its header; is it complete?": cache(PC2[:20]),
    "its header has …; at least one of each is needed": cache(PC2[:28] + struct.pack("<i3f", 0, 0, 0, 0)),
    "… take … bytes, it has …; is it complete?": cache(PC2[:-1]),
    "frame …, point …: its position is not finite": cache(PC2[:-4] + struct.pack("<f", np.nan)),
    "its times are not finite and increasing": cache(MDD[:12] + struct.pack(">f", -1) + MDD[16:], "a.mdd"),
    "--map: … has all vertices, in their order; leave it out": fitted("good.npz", "--map map.csv"),
    "--map: tells of the vertices of a scene; add --scene": converted("good.npz a.pc2 --map map.csv"),
    "no marker is seen in any frame": captured(seen=False),
    "… both belong to objects[…] vertex …; say with --map which vertex each is, or leave one out there": mapped(
        "marker,object,vertex\na,0,3\nb,0,3\n"
    ),
    "is not a text with commas: …": mapped("\udcff\udcfe"),
    "line 1: the names of the columns are needed: …": mapped("a,0,0\nb,0,1\n"),
    "line …: there is no marker …; there are …": mapped("marker,object,vertex\nc,0,0\n"),
    "line …: the marker … stands there twice": mapped("marker,object,vertex\na,0,0\na,0,1\n"),
    "line …: there is no … in …": mapped(f"marker,object,vertex\na,0,{VERTICES}\n"),
    "tells of no marker": mapped("marker,object,vertex\n\n"),
}
