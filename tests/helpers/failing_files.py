"""Files of other programs that are refused: motions, scenes, markers, meshes; see `failing`."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from clothfit.scene.scene import load
from helpers import marker_files, scene_files
from helpers.failing import GOOD, SMALL, VERTICES, Case, patched, raising

CORNER = b"v 0 0 0\n"
TRIANGLE = CORNER + b"v 1 0 0\nv 0 0 1\nf 1 2 3\n"
PC2 = struct.pack("<12siiffi3f", b"POINTCACHE2\0", 1, 1, 0, 1, 1, 0, 0, 0)
MDD = struct.pack(">ii2f6f", 2, 1, 0, 1, *range(6))
GAPS = {"positions": np.full((1, 2, 3), np.nan), "times": np.zeros(1), "observed": np.zeros((1, 2), bool)}

TABLE = b"time,a_x,a_y,a_z\n0,1,2,3\n"
HEAD = '#usda 1.0\n(upAxis = "Y"\nmetersPerUnit = 1)\n'
FACES = "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n"
POINTS = "[(0, 0, 0), (1, 0, 0), (0, 1, 0)]"
TWO = [0.0, 1.0]

PLY_HEAD = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACES = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
PLY = PLY_HEAD + PLY_FACES + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def target(name: str, options: str = "", **files: Any) -> Case:
    """A fit to a file."""
    return Case(f"estimate scene.json --target '{name}' {options}", files)


def converted(arguments: str, **files: Any) -> Case:
    """A conversion."""
    return Case(f"convert {arguments}", files)


def read(suffix: str, data: bytes | str) -> Case:
    """The conversion of a file with that content."""
    return converted(f"bad.{suffix} out.npz", **{f"bad.{suffix}": data if isinstance(data, bytes) else data.encode()})


def sequence(first: bytes, second: bytes, other: str = "a2.obj") -> Case:
    """The conversion of a sequence of two frames."""
    return converted("'a*.obj' b.pc2", **{"a1.obj": first, other: second})


def captured(mapping: str | None = None, seen: bool = True) -> Case:
    """A fit to two markers at the first two vertices, by a map."""
    a, b = load(SMALL).cloths[0].positions[:2].tolist()
    cells = ",".join(map(str, [*a, *b])) if seen else ",,,,,"
    files = {"a.csv": f"time,a_x,a_y,a_z,b_x,b_y,b_z\n0.02,{cells}\n".encode()}
    if mapping is None:
        return Case("estimate scene.json --target a.csv", files)
    files["map.csv"] = mapping.encode("utf-8", "surrogateescape")
    return Case("estimate scene.json --target a.csv --map map.csv", files)


def usd(*prims: str, head: str = HEAD) -> Case:
    """A file with meshes, by what is in their braces."""
    return read("usda", head + "".join(f'def Mesh "m{i}"\n{{\n{prim}\n}}\n' for i, prim in enumerate(prims)))


def samples(*each: str, codes: tuple[int, ...] = (1, 2)) -> str:
    """Points of a mesh over time."""
    inner = "".join(f"{code}: {points},\n" for code, points in zip(codes, each, strict=True))
    return f"point3f[] points.timeSamples = {{\n{inner}}}"


def glb(**changed: Any) -> Case:
    """Two triangles in a file with other parts."""
    return read("glb", scene_files.whole(*scene_files.parts(), **changed))


def targets(values: Any, count: int = 4) -> Case:
    """Two triangles with a target of so many vertices, and an animation of its weight."""
    return read("glb", scene_files.moved("weights", TWO, values, targets=[np.zeros((count, 3))]))


def accessor(longer: bool) -> Case:
    """Two triangles whose positions are more than there are, or not finite."""
    document, numbers = scene_files.parts()
    if longer:
        numbers.accessors[0]["count"] = 5
    else:
        numbers.accessors[0]["bufferView"] = numbers.view(np.full((4, 3), np.inf, np.float32).tobytes())
    return read("glb", scene_files.whole(document, numbers))


def ply(data: bytes, options: str = "") -> Case:
    """A mesh in a file of that text."""
    return Case(f"new mesh.ply {options}", {"mesh.ply": data})


def plane(options: str) -> Case:
    """A plane with options."""
    return Case(f"new plane {options}")


FORMATS = {
    "no motion format has that suffix; known are …": converted("good.npz a.txt"),
    "cannot write …: … can only be read": Case("simulate scene.json -o moved.ply"),
    "… needs …; install it with: pip install 'clothfit[…]'": patched(
        "simulate scene.json -o a.usd", "clothfit.formats.registry.import_module", raising(ImportError())
    ),
    "is a folder; a file with a motion is needed": target("a.obj", **{"a.obj/b.obj": CORNER}),
    "has no points": converted("empty.npz a.pc2", **{"empty.npz": {"positions": np.zeros((2, 0, 3))}}),
    "has … vertices, … has …; a motion needs all vertices of all objects, in their order: export it from the mesh that "
    "the scene was made from": target("a.obj", **{"a.obj": CORNER}),
    "has …, none of which is in --frames …": target("good.npz", "--frames 9:"),
    "frames: … is not A:B, such as 0:100, 50: or :-1 (B is left out)": target("good.npz", "--frames 9"),
    ".npz has the scene's axes and metres; leave --scale, --up, --handedness out": Case(
        "simulate scene.json -o a.npz --up z"
    ),
    "--mesh: … has … vertices, the motion has …": converted("good.npz a.pc2 --mesh a.obj", **{"a.obj": TRIANGLE}),
    # OBJ
    "has no vertices (lines v x y z); is it an OBJ file?": read("obj", b"hello"),
    "it is a picture; name another file": read("obj", b"\x89PNG\r\n"),
    "its content is …; rename it to …": read("stl", b"Ogawa"),
    "it is empty; export it again": read("mdd", b""),
    "a face needs three corners or more, each one of … vertices": read("obj", CORNER + b"f 1 2 3\n"),
    "has … vertices, …, as all frames need": sequence(TRIANGLE, CORNER),
    "has other faces than …; is it of another mesh?": sequence(TRIANGLE, TRIANGLE + b"f 1 2 3\n"),
    "a sequence has one …, in the name of its files, in place of their numbers": target("a*/b.obj"),
    "… are both frame …; remove one": sequence(CORNER, CORNER, "a01.obj"),
    # point caches
    "ends within its header; is it complete?": read("pc2", PC2[:20]),
    "its header has …; at least one of each is needed": read("pc2", PC2[:28] + struct.pack("<i3f", 0, 0, 0, 0)),
    "… take … bytes, it has …; is it complete?": read("pc2", PC2[:-1]),
    # which vertices markers are
    "--map: … has all vertices, in their order; leave it out": target("good.npz", "--map map.csv"),
    "--map: it names vertices of a scene; add --scene": converted("good.npz a.pc2 --map map.csv"),
    "no marker is seen in any frame": captured(seen=False),
    "… both belong to objects[…] vertex …; say with --map which vertex each is, or leave one out there": captured(
        "marker,object,vertex\na,0,3\nb,0,3\n"
    ),
    "the names of the columns are needed": captured("\udcff\udcfe"),
    "line …: there is no … in …": captured(f"marker,object,vertex\na,0,{VERTICES}\n"),
    # USD
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
    # glTF
    "some of its positions are not finite numbers": accessor(longer=False),
    "its numbers reach beyond the end of the buffer": accessor(longer=True),
    "it is not a glTF file: it begins neither with glTF, as .glb, nor with {, as .gltf": read("glb", b"hello"),
    "it is glTF version …; export version 2": read("glb", scene_files.container({}, version=1)),
    "it is cut off or damaged; export it again": read("glb", scene_files.container({}, length=10_000)),
    "its JSON cannot be read (…); it is cut off or damaged": read("glb", scene_files.container(b"{]}")),
    "it needs the extension …; export without it, uncompressed": glb(
        extensionsRequired=["KHR_draco_mesh_compression"]
    ),
    "…[…] does not exist": glb(scenes=[{"nodes": [7]}]),
    "its numbers are in …, which is not there; copy it beside, or export as .glb": glb(
        buffers=[{"byteLength": 9, "uri": "a.bin"}]
    ),
    "its numbers are in …, which is not a file in its folder; export as .glb": glb(
        buffers=[{"byteLength": 9, "uri": "https://localhost/a.bin"}]
    ),
    "its nodes are not a tree of at most … levels": read(
        "glb", scene_files.whole(*scene_files.parts([{"mesh": 0, "children": [0]}]))
    ),
    "a skeleton moves its mesh; bake the motion into shape keys or a point cache": read(
        "glb", scene_files.moved("translation", TWO, np.zeros((2, 3)), nodes=[{"mesh": 0, "skin": 0}])
    ),
    "… values of an animation do not match … times": targets([1.0, 2.0, 3.0]),
    "… weights do not match the … targets of a mesh": targets([1.0, 2.0, 3.0, 4.0]),
    "a target has … vertices, its mesh …": targets(TWO, 3),
    "… are more than a GLB file can have; keep fewer frames": patched(
        "convert good.npz out.glb", "clothfit.formats.glb.MOST_GLB_BYTES", 100
    ),
    # Alembic, STL
    "it is not an Alembic file, which begins with Ogawa": read("abc", b"hello"),
    "it is in Alembic's older container, HDF5; convert it with: abcconvert -toOgawa … new.abc": read("abc", b"\x89HDF"),
    "it was not written to its end; export it again": read("abc", b"Ogawa\0" + bytes(20)),
    "it is cut off, or no STL file: … triangles are promised, … are there; export it again": read("stl", b"\1" * 99),
    "it is cut off or damaged: …, … of them complete, with …, of which each needs 3; export it again": read(
        "stl", b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"
    ),
    # C3D, TRC, CSV
    "it is not a C3D file, whose second byte is 0x50": read("c3d", b"hello"),
    "… is not a type of processor that C3D knows (84, 85, 86)": read("c3d", marker_files.c3d(np.zeros((1, 1, 3)), 83)),
    "there are no markers in it": read("c3d", marker_files.c3d(np.zeros((1, 0, 3)))),
    "it has no …, only …; export the trajectories from Nexus": read("csv", b"Devices,,\n100,,\n"),
    "frames that are not at equal distances in time cannot be written; use .trc or .csv": converted(
        "uneven.npz out.c3d", **{"uneven.npz": {**GOOD, "times": np.arange(5.0) ** 2}}
    ),
    "… points are more than C3D can name; write another format": patched(
        "convert good.npz out.c3d", "clothfit.formats.c3d.LARGEST_WORD", 1
    ),
    "it is not a TRC file, which begins with … and has the names in line 4": read("trc", b"hello"),
    "it is not a table of cells (…)": read("csv", TABLE + b"1," + b"9" * 200_000),
    "its first line names no markers, as in time,hem_x,hem_y,hem_z": read("csv", b"time\n0\n"),
    "column …, …, is not time, frame or a coordinate such as hem_x": read("csv", b"time,a\n0,1\n"),
    "the marker … needs columns for x, y and z": read("csv", b"time,a_x,a_y\n0,1,2\n"),
    "a table with a line for each marker needs a column time or frame": read("csv", b"marker,x,y,z\na,1,2,3\n"),
    "line …: … is there twice in one frame; keep one": read("csv", b"time,marker,x,y,z\n0,a,1,2,3\n0,a,1,2,3\n"),
    "frame numbers must be whole and increasing, by less than …": read(
        "csv", b"frame,a_x,a_y,a_z\n2,1,2,3\n1,1,2,3\n"
    ),
}

MESHES = {
    "--fps must be above 0 and finite; 0 was given": plane("--fps 0"),
    "… is not understood; give it as in …": plane("--fix-box 1,2,3"),
    "stiffness must be at least 0 and finite; -1 was given": plane("--stiffness -1"),
    "integrator: there is no …; use …": plane("--integrator magic"),
    "fit: there is no …; use two letters, or …": plane("--fit colour"),
    "fit: … cannot be fitted as …; use …": plane("--fit wind=L"),
    "--fix-side: there is no …; use …": plane("--fix-side inside"),
    "--fix-side: the mesh is flat along …, so its … is all of it; name another": plane("--fix-side top"),
    "--fix-side: the reach must be at least 0 and finite; -1 m was given": plane("--fix-side left=-1"),
    "--fix-vertices: vertex 144 does not exist (the mesh has vertices 0 to …)": plane("--fix-vertices 144"),
    "weld: within … of most vertices are too many others; give a smaller one": patched(
        ply(PLY, "--weld 9"), "clothfit.meshes.topology.MOST_PAIRS", 1
    ),
    "a mesh is not read from standard input; name a file": Case("new -"),
    "has no faces; a cloth is made of triangles": ply(PLY_HEAD + b"end_header\n0 0 0\n1 0 0\n0 1 0\n"),
    "vertex … is not within … m of the origin; is the unit right?": ply(PLY.replace(b"0 1 0", b"0 nan 0")),
    "it has no header": ply(b"solid"),
    "its header has a line that is not understood: …": ply(PLY.replace(b"end_", b"property complex w\nend_")),
    "its header does not name the format": ply(b"ply\nelement vertex 3\nend_header\n"),
    "it has … bytes where its header asks for … or more": ply(PLY.replace(b"vertex 3", b"vertex 3000000000")),
    "a word in it is not a number": ply(PLY.replace(b"1 0 0", b"1 0 zero")),
    "so many lists of different lengths take more memory than is free": patched(
        ply(PLY.replace(b"face 1", b"face 2") + b"2 0 1\n"), "clothfit.formats.ply.PROPERTY_BYTES", 10**15
    ),
    "it has no vertices with …": ply(PLY.replace(b"float y", b"float w")),
    "its faces are not lists of vertices": ply(PLY.replace(b"list uchar int", b"int").replace(b"3 0 1 2", b"0")),
    "a face names vertex …; there are …": ply(PLY.replace(b"3 0 1 2", b"3 0 1 3")),
}
FAMILIES = {"formats": FORMATS, "meshes": MESHES}
