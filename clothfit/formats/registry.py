"""One table of what a file is: the formats of motions and meshes by suffix and first bytes, and what else there is.

The module of a format has

    read(path[, wanted]) -> Animation            raises InvalidMotion, naming the file and what is wrong with it
    scan(path) -> Animation                      of a sequence whose frames have other points
    paths(path) -> list                          of all meshes, where files have names of them to be `wanted`
    encoded(path, animation) -> {path: data}     the files to write, in the animation's axes; for a sequence many

and loads its library only when one of them is called. A file may come from anybody: a reader compares the sizes that it
claims with its length before taking memory, and turns whatever a library raises into an InvalidMotion.

What a file is by its beginning is for messages, and for `clothfit info`: so that one in the wrong place can be told its
right one. Whoever reads a file finds out for sure.
"""

from __future__ import annotations

import json
import os
import zipfile
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.base.reading import unchanged
from clothfit.formats.axes import RIGHT, Z_UP, Axes
from clothfit.formats.files import name_of

if TYPE_CHECKING:
    from clothfit.formats.animation import Animation

SCENE, MOTION, MESH, EITHER = "scene", "motion", "mesh", "mesh or motion"
CHECKPOINT, LOG, PAGE, MAP, EXPORT = "checkpoint", "log", "page", "map", "export"
FORCES, SUBSPACE, RECORDED = "file of forces", "subspace", "file of recorded motions"


class Format(NamedTuple):
    """A format of files that hold motions or meshes."""

    name: str  # in messages
    suffixes: tuple[str, ...]  # in lower case
    module: str  # in this package
    axes: Axes  # where the file does not name them
    begins: tuple[tuple[bytes, str], ...] = ()  # first bytes, in either case, and the suffix of files with them
    kind: str = MOTION  # what such a file is for: MOTION, MESH, or EITHER, with one frame or many
    writes: bool = True  # whether it can be written
    times: bool = True  # whether it has the times of its frames
    markers: bool = False  # whether it holds markers, which need not be all vertices and may have gaps
    extra: str | None = None  # the optional extra of this package that installs what it needs
    library: str | None = None  # which library that is
    single: bool = False  # whether positions are float32

    @property
    def faces(self) -> bool:
        """Whether it can hold faces."""
        return self.kind != MOTION


USD = ((b"PXR-USDC", ".usdc"), (b"#usda", ".usda"))
PLY = ((b"ply\n", ".ply"), (b"ply\r", ".ply"))
TRC = ((b"PathFileType", ".trc"),)

FORMATS = (
    Format("OBJ sequence", (".obj",), "obj", RIGHT, kind=MESH, times=False),
    Format("PC2 point cache", (".pc2",), "point_cache", RIGHT, ((b"POINTCACHE2", ".pc2"),), times=False, single=True),
    Format("MDD point cache", (".mdd",), "point_cache", RIGHT, single=True),
    Format("USD", (".usd", ".usda", ".usdc"), "usd", RIGHT, USD, EITHER, extra="usd", library="pxr", single=True),
    Format("glTF", (".glb", ".gltf"), "glb", RIGHT, ((b"glTF", ".glb"),), EITHER, single=True),
    Format("Alembic", (".abc",), "alembic", RIGHT, ((b"Ogawa", ".abc"),), EITHER, writes=False),
    Format("PLY mesh", (".ply",), "ply", RIGHT, PLY, MESH, writes=False, times=False),
    Format("STL mesh", (".stl",), "stl", Z_UP, ((b"solid ", ".stl"),), MESH, writes=False, times=False),
    Format("C3D markers", (".c3d",), "c3d", Axes("z", "right", 0.001), markers=True, single=True),
    Format("TRC markers", (".trc",), "markers", Axes("y", "right", 0.001), TRC, markers=True),
    Format("CSV markers", (".csv",), "markers", RIGHT, markers=True),
)
"""The formats of other programs. This program's own, `.npz` and `.npy`, are in `motion`, in the scene's axes."""

NATIVE = (".npz", ".npy")


class Content(NamedTuple):
    """What a file is that begins so."""

    what: str  # for messages
    suffix: str = ""  # its own, where that is a format that is read
    remedy: str = ""  # what to do with any other
    kind: str | None = None  # one of the above, where the beginning says it


ANIMATION = "export it as .glb, .usd, .abc or .obj"
SURFACE = "export it as .ply, .stl or .obj"
FOR_A_TOOL = Content("an export for another tool", remedy="name the scene that it was made of", kind=EXPORT)
NUMPY = Content("NumPy", ".npy", kind=MOTION)
ZIP = b"PK\x03\x04"
PACKED = {
    b"subspace.npy": Content("a subspace", remedy="it goes with clothfit subspace play", kind=SUBSPACE),
    b"fit.npy": Content("a checkpoint", remedy="it goes with estimate --resume", kind=CHECKPOINT),
    b"search.npy": Content("a checkpoint", remedy="it goes with control --resume"),
    b"training.npy": Content("a training's state", remedy="it goes with subspace build --resume"),
    b"recorded.npy": Content("recorded motions", remedy="they go with clothfit subspace build", kind=RECORDED),
}
"""Zip archives by the name of their first file."""

FAMILIAR = {
    NUMPY: (b"\x93NUMPY",),
    FOR_A_TOOL: (
        b'{"format": "clothfit-', b'"""Set the values that clothfit found', b"object,vertices,springs,",
        b"object,vertex,x,y,z,", b"object,spring,a,b,",
    ),
    Content("a Houdini geometry", remedy=ANIMATION): (b'["fileversion", ',),
    Content("a gzip archive", remedy="unpack it"): (b"\x1f\x8b",),
    Content("a zip archive", remedy="unpack it"): (ZIP,),
    Content("an FBX file", remedy=ANIMATION): (b"; FBX", b"Kaydara FBX"),
    Content("a Blender file", remedy=ANIMATION): (b"BLENDER",),
    Content("an XML file, as COLLADA's and VTK's are", remedy=ANIMATION): (b"<?xml",),
    Content("a VTK file", remedy=SURFACE): (b"# vtk DataFile",),
    Content("an OFF mesh", remedy=SURFACE): (b"OFF\n", b"OFF\r"),
    Content("a Gmsh mesh", remedy=SURFACE): (b"$MeshFormat",),
    Content("an HDF5 file", remedy="export it in another format"): (b"\x89HDF",),
    Content("a pointer of Git LFS, not the file itself", remedy="fetch that with: git lfs pull"): (
        b"version https://git-lfs",
    ),
    Content("a web page", remedy="download the file itself", kind=PAGE): (b"<!doctype html", b"<html"),
    Content("a picture", remedy="name another file"): (b"\xff\xd8\xff", b"\x89PNG", b"GIF8"),
    Content("a PDF document", remedy="name another file"): (b"%PDF",),
}  # fmt: skip
"""What there is beside these formats, and how it begins."""

CONTENTS = {begin: Content(each.name.split()[0], suffix) for each in FORMATS for begin, suffix in each.begins}
CONTENTS |= {begin: content for content, begins in FAMILIAR.items() for begin in begins}

FIRST = 1 << 16
"""Bytes that are looked at."""

NAME_LENGTH, NAME = slice(26, 28), 30
"""Where a zip archive has the length of the name of its first file, and where that begins."""

TABLE = b"time,vertex,fx,fy,fz"  # how a table of forces begins
SCENES = ("", ".json", ".txt")
"""Suffixes that a scene may have."""


def suffix_of(path: str | os.PathLike[str]) -> str:
    """The suffix of a file's name, in lower case."""
    return os.path.splitext(os.fsdecode(path))[1].lower()


def foreign(path: object) -> Format | None:
    """The format of another program's file by its suffix; None for any other suffix or object."""
    suffix = suffix_of(path) if isinstance(path, (str, os.PathLike)) else ""
    return next((each for each in FORMATS if suffix in each.suffixes), None)


def format_of(path: str | os.PathLike[str], writing: bool = False) -> Format | None:
    """The format of a file by its suffix; None for this program's own. Raises InvalidInput for any other suffix, with
    what the file is or with the suffixes of what can be read, or written.
    """
    found = foreign(path)
    if found is not None or suffix_of(path) in NATIVE:
        return found
    what = None if writing else wrong_kind(path, suffix_of(path))
    if what is not None:
        raise InvalidInput(f"{os.fspath(path)}: {what}")
    known = [NATIVE[0], *(suffix for each in FORMATS if each.writes or not writing for suffix in each.suffixes)]
    advice = "use one of these" if writing else "export it as one"
    raise InvalidInput(
        f"{os.fspath(path)}: no motion format has that suffix; known are {', '.join(known)}; {advice}"
    )


def module_of(kind: Format) -> Any:
    """The module that reads and writes a format. Raises InvalidInput when its library is not installed."""
    if kind.library is not None:
        try:
            import_module(kind.library)
        except ImportError:
            need = f"{kind.name} needs {kind.library}; install it with: pip install 'clothfit[{kind.extra}]'"
            raise InvalidInput(need) from None
    return import_module(f"clothfit.formats.{kind.module}")


def paths(found: Format | None, path: str | os.PathLike[str]) -> list[str]:
    """The paths of the meshes in a file; none where its format has no names for them. Raises InvalidMotion."""
    module: Any = None if found is None else module_of(found)
    every: list[str] = module.paths(path) if hasattr(module, "paths") else []
    return every


def read_format(kind: Format, path: str | os.PathLike[str], wanted: str = "", scan: bool = False) -> Animation:
    """Read a file of a format, of several meshes those that are `wanted`, names with commas between, or as a `scan`.
    Raises InvalidMotion, where the content is not that of the suffix with what it is, and InvalidInput when the library
    that reads it is missing.
    """
    module = module_of(kind)
    if wanted and not hasattr(module, "paths"):
        raise InvalidInput(f"{name_of(path)}: {kind.name} has no names of meshes; leave the name out")
    try:
        way = module.scan if scan and hasattr(module, "scan") else module.read
        content: Animation = way(path, wanted) if wanted else way(path)
    except InvalidMotion as error:
        what = wrong_kind(path, suffix_of(path))
        raise error if what is None else InvalidMotion(f"{name_of(path)}: {what}") from None
    return content


def beginning(path: str | os.PathLike[str]) -> tuple[bytes, Content | None] | None:
    """The first bytes of a file after a byte order mark and white space, and what begins so; None where there is no
    such file.
    """
    try:
        if not os.path.isfile(path):
            return None
        with unchanged(path) as file:
            first = file.read(FIRST).removeprefix(b"\xef\xbb\xbf").lstrip()
            if not first.startswith(ZIP):
                low = first[:64].lower()
                return first, next((each for begin, each in CONTENTS.items() if low.startswith(begin.lower())), None)
            with suppress(ValueError, zipfile.BadZipFile, NotImplementedError), zipfile.ZipFile(file) as archive:
                return first, _packed(first, archive.namelist())
            return first, _packed(first, [])
    except (OSError, ValueError):
        return None


def _packed(first: bytes, names: list[str]) -> Content:
    """What a zip archive is by the name of its first file and those of all."""
    name = first[NAME : NAME + int.from_bytes(first[NAME_LENGTH], "little")].lower()
    if name in PACKED:
        return PACKED[name]
    if name.endswith(b".npy"):
        pushes = "forces.npy" in names and "positions.npy" not in names
        return NUMPY._replace(suffix=".npz", kind=FORCES if pushes else MOTION)
    if name.endswith((b".usd", b".usda", b".usdc")):
        return Content("a USDZ package", remedy="unpack it, as a zip archive, and name the USD file in it")
    return CONTENTS[ZIP]


def kind_of(path: str) -> str | None:
    """One of the kinds; None for what is not known, and for what is no file, such as a pipe."""
    suffix, seen = suffix_of(path), beginning(path)
    if "*" in path and suffix in (".obj", ".ply"):
        return EITHER  # a sequence, or the mesh of its first frame
    if seen is None:
        return None
    first, content = seen
    line = first.split(b"\n", 1)[0]
    if content is not None and content.kind is not None:
        return content.kind
    if first.startswith(b"{") and suffix != ".gltf":
        return LOG if _is_log(line) else SCENE
    if suffix == ".csv" and line.strip() == TABLE:
        return FORCES
    if suffix == ".csv" and b"vertex" in line.lower():
        return MAP
    found = foreign(path)
    return found.kind if found is not None else MOTION if suffix in NATIVE else None


def _is_log(line: bytes) -> bool:
    with suppress(ValueError, RecursionError):
        entry = json.loads(line)
        return isinstance(entry, dict) and ("evaluations" in entry or set(entry) == {"summary"})
    return False


def wrong_kind(path: str | os.PathLike[str], suffix: str) -> str | None:
    """What a file is and what to do, where it is empty or its content is known not to be that of its suffix."""
    first, found = beginning(path) or (b" ", None)
    if not first:
        return "it is empty; export it again"
    if found is None or (suffix == ".abc" and first.startswith(b"\x89HDF")):  # which its reader explains
        return None
    if not found.suffix:
        return f"it is {found.what}; {found.remedy}"
    return None if found.suffix[:4] == suffix[:4] else f"its content is {found.what}; rename it to {found.suffix}"


def no_scene(path: str | os.PathLike[str], suffix: str) -> str | None:
    """What a file is that was read as a scene and is no JSON object; None where it may be meant as one."""
    first, content = beginning(path) or (b"", None)
    if not first or (first.startswith(b"{") and content is None):
        return None
    what = wrong_kind(path, suffix)
    if what is None and suffix not in SCENES:
        return f"it is no scene, which is a JSON object, and {suffix} is no format that is read; export it as another"
    return what
