"""What provokes the errors of scene and marker files of other programs, by their message; see `provoked`."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
from pxr import Tf

from clothfit.formats import usd_reader
from helpers import marker_files, scene_files
from helpers.provoked import GOOD, Case, patched

TABLE = b"time,a_x,a_y,a_z\n0,1,2,3\n"
TWO = [0.0, 1.0]
HEAD = '#usda 1.0\n(upAxis = "Y"\nmetersPerUnit = 1)\n'
FACES = "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n"
POINTS = "[(0, 0, 0), (1, 0, 0), (0, 1, 0)]"


def read(suffix: str, data: bytes | str) -> Case:
    """The conversion of a file with that content."""
    content = data if isinstance(data, bytes) else data.encode()
    return Case(f"convert bad.{suffix} out.npz", {f"bad.{suffix}": content})


def within(command: list[str], around: dict[str, str], seconds: float) -> tuple[int, bytes]:
    """What the process that reads USD tells, without the time that it takes to start."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        try:
            code = usd_reader.main(*command[-3:])
        except Tf.ErrorException:
            code = 1
    return code, told.getvalue().encode()


def prepare(patch: Any) -> None:
    patch.setattr("clothfit.formats.usd._run", within)
    patch.setattr("clothfit.formats.usd_reader.limit_memory", lambda *room, **more: None)


def usd(*prims: str, head: str = HEAD) -> Case:
    """A file with meshes, by what is in their braces."""
    text = head + "".join(f'def Mesh "m{i}"\n{{\n{prim}\n}}\n' for i, prim in enumerate(prims))
    return Case("convert bad.usda out.npz", {"bad.usda": text.encode()}, prepare)


def samples(*each: str, codes: tuple[int, ...] = (1, 2)) -> str:
    """Points of a mesh over time."""
    inner = "".join(f"{code}: {points},\n" for code, points in zip(codes, each, strict=True))
    return f"point3f[] points.timeSamples = {{\n{inner}}}"


def glb(**changed: Any) -> Case:
    """Two triangles in a file with other parts."""
    return read("glb", scene_files.whole(*scene_files.parts(), **changed))


def mesh(nodes: Any = None, **primitive: Any) -> Case:
    """Two triangles with another node, or other parts of the mesh."""
    return read("glb", scene_files.whole(*scene_files.parts(nodes, **primitive)))


def targets(values: Any, count: int = 4) -> Case:
    """Two triangles with a target of so many vertices, and an animation of its weight."""
    return read("glb", scene_files.moved("weights", TWO, values, targets=[np.zeros((count, 3))]))


def longer() -> bytes:
    document, numbers = scene_files.parts()
    numbers.accessors[0]["count"] = 5
    return scene_files.whole(document, numbers)


def infinite() -> bytes:
    document, numbers = scene_files.parts()
    numbers.accessors[0]["bufferView"] = numbers.view(np.full((4, 3), np.inf, np.float32).tobytes())
    return scene_files.whole(document, numbers)


def skinned() -> bytes:
    return scene_files.moved("translation", TWO, np.zeros((2, 3)), nodes=[{"mesh": 0, "skin": 0}])


COMMANDS: dict[str, Case] = {
    "the USD library cannot read it; it is damaged, or of another format": read("usda", b"hello"),
    "there is no mesh in it": usd(),
    "there is no mesh in it, only the names of other files; flatten it first": usd(
        head=HEAD + 'def "a" (references = @b.usda@)\n{\n}\n'
    ),
    "… have samples at different times; export one of them alone": usd(
        FACES + samples(POINTS, POINTS), FACES + samples(POINTS, POINTS, codes=(1, 3))
    ),
    "its number of points changes over time; it must stay the same": usd(FACES + samples(POINTS, "[(0, 0, 0)]")),
    "it has no points": usd(FACES),
    "its faces change over time; they must stay the same": usd(
        samples(POINTS, POINTS) + "\nint[] faceVertexCounts = [3]\n"
        "int[] faceVertexIndices.timeSamples = {\n1: [0, 1, 2],\n2: [0, 2, 1],\n}"
    ),
    "its faces need … corners and have …": usd(f"point3f[] points = {POINTS}\nint[] faceVertexCounts = [3]"),
    "a triangle names a vertex beyond the … of its mesh": usd(FACES + "point3f[] points = [(0, 0, 0)]"),
    "… cannot be; up is Y or Z, and the others are above 0": usd(
        FACES + f"point3f[] points = {POINTS}", head="#usda 1.0\n(metersPerUnit = 0)\n"
    ),
    "some of its positions are not finite numbers": read("glb", infinite()),
    "it is not a GLB file, which begins with glTF; export as .glb": read("glb", b"hello"),
    "it is glTF version …; export version 2": read("glb", scene_files.container({}, version=1)),
    "it is cut off or damaged; export it again": read("glb", scene_files.container({}, length=10_000)),
    "its JSON cannot be read (…)": read("glb", scene_files.container(b"{]}")),
    "it needs the extension …; export without it, uncompressed": glb(
        extensionsRequired=["KHR_draco_mesh_compression"]
    ),
    "…[…] does not exist": glb(scenes=[{"nodes": [7]}]),
    "its numbers reach beyond the end of the buffer": read("glb", longer()),
    "its numbers are in another file; export all into one .glb": glb(buffers=[{"byteLength": 9, "uri": "a.bin"}]),
    "its nodes are not a tree of at most … levels": mesh([{"mesh": 0, "children": [0]}]),
    "a skeleton moves its mesh; bake the motion into shape keys or a point cache": read("glb", skinned()),
    "… values of an animation do not match … times": targets([1.0, 2.0, 3.0]),
    "… weights do not match the … targets of a mesh": targets([1.0, 2.0, 3.0, 4.0]),
    "a target has … vertices, its mesh …": targets(TWO, 3),
    "… are more than a GLB file can have; keep fewer frames": patched(
        Case("convert good.npz out.glb"), "clothfit.formats.glb.MOST_GLB_BYTES", 100
    ),
    "it is not a C3D file, whose second byte is 0x50": read("c3d", b"hello"),
    "… is not a type of processor that C3D knows (84, 85, 86)": read("c3d", marker_files.c3d(np.zeros((1, 1, 3)), 83)),
    "there are no markers in it": read("c3d", marker_files.c3d(np.zeros((1, 0, 3)))),
    "it ends early: … frames are promised, … are there": read("c3d", marker_files.c3d(np.zeros((9, 1, 3)))[:-16]),
    "frames that are not at equal distances in time cannot be written; use .trc or .csv": Case(
        "convert uneven.npz out.c3d", {"uneven.npz": {**GOOD, "times": np.arange(5.0) ** 2}}
    ),
    "… points are more than C3D can name; write another format": patched(
        Case("convert good.npz out.c3d"), "clothfit.formats.c3d.LARGEST_WORD", 1
    ),
    "it is not a TRC file, which begins with … and has the names in line 4": read("trc", b"hello"),
    "line …: it has … cells, … are named": read("csv", TABLE + b"1,1,2,3,4\n"),
    "it is not a table of cells (…)": read("csv", TABLE + b"1," + b"9" * 200_000),
    "its first line names no markers, as in time,hem_x,hem_y,hem_z": read("csv", b"time\n0\n"),
    "column …, …, is not time, frame or a coordinate such as hem_x": read("csv", b"time,a\n0,1\n"),
    "column …, …, is there twice": read("csv", b"time,a_x,a_y,a_z,a_x\n0,1,2,3,4\n"),
    "the marker … needs columns for x, y and z": read("csv", b"time,a_x,a_y\n0,1,2\n"),
    "a table with a line for each marker needs a column time or frame": read("csv", b"marker,x,y,z\na,1,2,3\n"),
    "line …: … is there twice in one frame; keep one": read("csv", b"time,marker,x,y,z\n0,a,1,2,3\n0,a,1,2,3\n"),
    "frame numbers must be whole and increasing, by less than …": read(
        "csv", b"frame,a_x,a_y,a_z\n2,1,2,3\n1,1,2,3\n"
    ),
}
