"""Files whose content is not what their suffix says: the message says what they are."""

import gzip
import io
import zipfile

import numpy as np
import pytest
from helpers.paths import TESTS

from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.formats.axes import Reading
from clothfit.formats.registry import FORMATS, foreign, read
from clothfit.meshes.mesh import read_mesh
from clothfit.motion.foreign import load

BLENDER = TESTS / "formats" / "blender"
PAGE = b"<!DOCTYPE html>\n<html><head><title>404</title></head></html>"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.usdc", (BLENDER / "sheet.abc").read_bytes(), "its content is Alembic; rename it to .abc"),
        ("a.abc", (BLENDER / "sheet.usdc").read_bytes(), "its content is USD; rename it to .usdc"),
        ("a.obj", (BLENDER / "sheet-text.stl").read_bytes(), "its content is STL; rename it to .stl"),
        ("a.stl", (BLENDER / "sheet.glb").read_bytes(), "its content is glTF; rename it to .glb"),
        ("a.obj", gzip.compress(b"v 0 0 0\n", mtime=0), "it is a gzip archive; unpack it"),
        ("a.glb", PAGE, "it is a web page; download the file itself"),
        ("a.csv", POINTER, "it is a pointer of Git LFS, not the file itself; fetch that with: git lfs pull"),
        ("a.obj", b"OFF\n3 1 0\n", "it is an OFF mesh; export it as .ply, .stl or .obj"),
        ("a.obj", b"# vtk DataFile Version 3.0\n", "it is a VTK file; export it as .ply, .stl or .obj"),
        ("a.pc2", b"BLENDER-v402", "it is a Blender file; export it as .glb, .usd, .abc or .obj"),
    ],
)
def test_a_wrong_suffix_is_named(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidMotion) as caught:
        read(foreign(name), tmp_path / name)
    assert str(caught.value) == f"{name}: {message}"


def packed(name):
    """A zip archive of one file."""
    with zipfile.ZipFile(out := io.BytesIO(), "w") as archive:
        archive.writestr(name, b"anything")
    return out.getvalue()


@pytest.mark.parametrize("suffix", [each.suffixes[-1] for each in FORMATS])
def test_an_empty_file_is_called_empty(tmp_path, suffix):
    if foreign(f"a{suffix}").library is not None:
        pytest.importorskip(foreign(f"a{suffix}").library)
    (tmp_path / f"a{suffix}").write_bytes(b"")
    with pytest.raises(InvalidMotion, match=r"^a\..*: it is empty; export it again$"):
        read(foreign(f"a{suffix}"), tmp_path / f"a{suffix}")


# A file with any suffix may be one of this program's, as a pipe has no name.
def test_an_unknown_suffix_is_refused_unless_the_content_is_known(tmp_path):
    np.savez(tmp_path / "other.npz", vertices=np.zeros(3))
    for name, content, message in (
        ("a.vtk", b"hello", r"no motion format has that suffix; known are .*; export it as one"),
        ("a.fbx", (tmp_path / "other.npz").read_bytes(), r"its content is NumPy; rename it to \.npz"),
        ("a.usdz", packed("shirt.usdc"), "it is a USDZ package; unpack it, as a zip archive, and name the USD file in"),
        ("a.zip", packed("shirt.png"), "it is a zip archive; unpack it"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InvalidInput, match=rf"{name}: {message}"):
            load(tmp_path / name, None, Reading())
        with pytest.raises(InvalidInput, match=rf"{name}: {message.replace('motion', 'mesh')}"):
            read_mesh(tmp_path / name)
    positions = np.random.default_rng(0).normal(size=(2, 4, 3))
    for name, save in (
        ("a.motion", lambda file: np.savez(file, positions=positions)),
        ("a.dat", lambda file: np.save(file, positions)),
    ):
        with open(tmp_path / name, "wb") as file:
            save(file)
        np.testing.assert_array_equal(load(tmp_path / name, None, Reading()).motion.positions, positions)
