"""What provokes the errors of `clothfit new` and `clothfit validate`; see `provoked`."""

from __future__ import annotations

from typing import Any

from helpers.provoked import SMALL, Case, patched
from helpers.scenes import changed

HEADER = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACES = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
CORNERS = b"0 0 0\n1 0 0\n0 1 0\n"
TRIANGLE = HEADER + FACES + CORNERS + b"3 0 1 2\n"
EDGED = TRIANGLE.replace(b"face 1", b"face 2")  # with a list of another length


def plane(options: str) -> Case:
    """A plane with options."""
    return Case(f"new plane {options}")


def ply(data: bytes, options: str = "") -> Case:
    """A mesh in a file of that text."""
    return Case(f"new mesh.ply {options}", {"mesh.ply": data})


def numbered(value: Any) -> Case:
    """A scene with that field of a mesh's numbers, to which a motion of the mesh is read."""
    from clothfit.scene.mesh_numbering import FIELD

    return Case("info scene.json", {"scene.json": changed(SMALL, ("objects", 0, FIELD), value)})


COMMANDS: dict[str, Case] = {
    "… is for …; leave it out": plane("--scale 2"),
    "… and … say the same; give one of them": plane("--delta 0.1 --fps 10"),
    "--fps must be above 0 and finite; … was given": plane("--fps 0"),
    "… is not understood; give it as in …": plane("--fix-box 1,2,3"),
    "… must be … and finite; … was given": plane("--stiffness -1"),
    "integrator: there is no …; use …": plane("--integrator magic"),
    "fit: there is no …; use two letters, or …": plane("--fit colour"),
    "fit: … cannot be fitted as …; use …": plane("--fit wind=L"),
    "fix side: there is no …; use …": plane("--fix-side inside"),
    "fix side: the mesh is flat along …, so its … is all of it; name another": plane("--fix-side top"),
    "fix side: the reach must be at least 0 and finite; … m was given": plane("--fix-side left=-1"),
    "fix vertices: vertex … does not exist (the mesh has vertices 0 to …)": plane("--fix-vertices 144"),
    "a plane of … divisions would have … vertices; it may have at most …": plane("--divisions 100000"),
    "weld: within … of most vertices are too many others; give a smaller one": patched(
        ply(TRIANGLE, "--weld 9"), "clothfit.meshes.topology.MOST_PAIRS", 1
    ),
    "scale must be above 0 and finite; … m was given": ply(TRIANGLE, "--scale 0"),
    "a mesh is not read from standard input; name a file": Case("new -"),
    "meshes are not read from files of that suffix; known are …": Case("new good.npz"),
    "has no faces; a cloth is made of triangles": ply(HEADER + b"end_header\n" + CORNERS),
    "vertex … has no place within … m of the origin; is the unit right?": ply(TRIANGLE.replace(b"0 1 0", b"0 nan 0")),
    "no cloth can be made of this mesh: …": ply(TRIANGLE.replace(b"3 0 1 2", b"3 0 1 1")),
    "is no list that names each of the … vertices; take the field away": numbered([0, 1]),
    "… of … scenes are not valid: …": Case("validate scene.json bad.json", {"bad.json": b"{}"}),
    "cannot write …: … can only be read": Case("simulate scene.json -o moved.ply"),
    "cannot be read as .ply: …": ply(TRIANGLE.replace(b"float y", b"float x")),
    "it has no header": ply(b"solid"),
    "its header has a line that is not understood: …": ply(HEADER + b"property complex w\nend_header\n" + CORNERS),
    "its header does not name the format": ply(b"ply\nelement vertex 3\nend_header\n"),
    "it has … bytes where its header asks for … or more": ply(TRIANGLE.replace(b"vertex 3", b"vertex 3000000000")),
    "a word in it is not a number": ply(TRIANGLE.replace(b"1 0 0", b"1 0 zero")),
    "so many lists of different lengths take more memory than is free": patched(
        ply(EDGED + b"2 0 1\n"), "clothfit.formats.ply.PROPERTY_BYTES", 10**15
    ),
    "it has no vertices with …": ply(TRIANGLE.replace(b"float y", b"float w")),
    "its faces are not lists of vertices": ply(
        TRIANGLE.replace(b"list uchar int", b"int").replace(b"3 0 1 2", b"0")
    ),
    "a face names vertex …; there are …": ply(TRIANGLE.replace(b"3 0 1 2", b"3 0 1 3")),
}
"""By message. Each ends the command with the code of its row."""
