"""The formats of motion files, by their suffix.

The module of a format has

    read(path) -> Animation                      raises InvalidMotion, naming the file and what is wrong with it
    encoded(path, animation) -> {path: data}     the files to write, in the animation's axes; for a sequence many

and loads its library only when one of them is called. A file may come from anybody: a reader compares the sizes that it
claims with its length before taking memory, and turns whatever a library raises into an InvalidMotion.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.formats.axes import RIGHT, Axes

if TYPE_CHECKING:
    from clothfit.formats.animation import Animation


class Format(NamedTuple):
    """A format of files that hold motions."""

    name: str  # in messages
    suffixes: tuple[str, ...]  # in lower case
    module: str  # in this package
    axes: Axes  # where the file does not name them
    writes: bool = True  # whether it can be written
    times: bool = True  # whether it has the times of its frames
    markers: bool = False  # whether it holds markers, which need not be all vertices and may have gaps
    faces: bool = True  # whether it can hold faces
    extra: str | None = None  # the optional extra of this package that installs what it needs
    library: str | None = None  # which library that is
    single: bool = False  # whether positions are float32


FORMATS = (
    Format("OBJ sequence", (".obj",), "obj", RIGHT, times=False),
    Format("PC2 point cache", (".pc2",), "point_cache", RIGHT, times=False, faces=False, single=True),
    Format("MDD point cache", (".mdd",), "point_cache", RIGHT, faces=False, single=True),
    Format("USD", (".usd", ".usda", ".usdc"), "usd", RIGHT, extra="usd", library="pxr", single=True),
    Format("glTF", (".glb", ".gltf"), "glb", RIGHT, single=True),
    Format("Alembic", (".abc",), "alembic", RIGHT, writes=False),
    Format("PLY mesh", (".ply",), "ply", RIGHT, writes=False, times=False),
    Format("STL mesh", (".stl",), "stl", Axes("z", "right", 1.0), writes=False, times=False),
    Format("C3D markers", (".c3d",), "c3d", Axes("z", "right", 0.001), markers=True, faces=False, single=True),
    Format("TRC markers", (".trc",), "trc", Axes("y", "right", 0.001), markers=True, faces=False),
    Format("CSV markers", (".csv",), "marker_table", RIGHT, markers=True, faces=False),
)
"""The formats of other programs. This program's own, `.npz` and `.npy`, are in `motion`, in the scene's axes."""

NATIVE = (".npz", ".npy")


def format_of(path: str | os.PathLike[str], writing: bool = False) -> Format | None:
    """The format of a file by its suffix; None for this program's own. Raises InvalidInput for any other suffix, with
    what the file is or with the suffixes of what can be read, or written.
    """
    found = foreign(path)
    if found is not None or suffix_of(path) in NATIVE:
        return found
    from clothfit.formats.signatures import mistaken

    what = None if writing else mistaken(path, suffix_of(path))
    if what is not None:
        raise InvalidInput(f"{os.fspath(path)}: {what}")
    known = [NATIVE[0], *(suffix for each in FORMATS if each.writes or not writing for suffix in each.suffixes)]
    advice = "use one of these" if writing else "export it as one"
    raise InvalidInput(
        f"{os.fspath(path)}: no motion format has that suffix; known are {', '.join(known)}; {advice}"
    )


def foreign(path: object) -> Format | None:
    """The format of another program's file by its suffix; None for any other suffix or object."""
    suffix = suffix_of(path) if isinstance(path, (str, os.PathLike)) else ""
    return next((each for each in FORMATS if suffix in each.suffixes), None)


def read(found: Format, path: str | os.PathLike[str]) -> Animation:
    """Read a file of a format. Raises InvalidMotion, and InvalidInput when the library that reads it is missing."""
    module = module_of(found)
    try:
        content: Animation = module.read(path)
    except InvalidMotion as error:
        from clothfit.formats.signatures import explained

        raise explained(path, suffix_of(path), error) from None
    return content


def suffix_of(path: str | os.PathLike[str]) -> str:
    """The suffix of a file's name, in lower case."""
    return os.path.splitext(os.fsdecode(path))[1].lower()


def module_of(found: Format) -> Any:
    """The module that reads and writes a format. Raises InvalidInput when its library is not installed."""
    if found.library is not None:
        try:
            import_module(found.library)
        except ImportError:
            need = f"{found.name} needs {found.library}; install it with: pip install 'clothfit[{found.extra}]'"
            raise InvalidInput(need) from None
    return import_module(f"clothfit.formats.{found.module}")
