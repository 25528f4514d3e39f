"""Files that other programs wrote: a sheet that Blender 4.2 exported (tests/formats/blender/make.py), and those of
../shared/files, which are not part of this repository."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from clothfit import InvalidMotion
from clothfit.formats import alembic, glb, markers, stl, usd
from clothfit.formats.axes import Axes

BLENDER = Path(__file__).parent / "blender"
SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "files"
SINGLE = 4e-7  # of float32 numbers up to 4: half of the last of 24 bits is 2.4e-7, and transforms add some


def sheet():
    """Positions (5, 9, 3) of the sheet that make.py describes, z up."""
    y, x = np.mgrid[0:3, 0:3].reshape(2, -1) / 2
    weight = np.arange(5)[:, None] / 4
    return np.stack(np.broadcast_arrays(1 - 2 * y + weight, 2 + x, 3 + 0.5 * weight * x * y), axis=-1)


def y_up(points):
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def in_order(points):
    """Points in an order that rounding does not change."""
    return points[np.lexsort(np.round(points, 3).T)]


def normals(points, triangles):
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


# Blender's faces look up at first, along z, and the scale keeps that.
@pytest.mark.parametrize(
    ("module", "name", "up"),
    [(alembic, "sheet.abc", "y"), (glb, "sheet.glb", "y"), (glb, "sheet.gltf", "y"),
     pytest.param(usd, "sheet.usdc", "z", marks=pytest.mark.slow)],
)  # fmt: skip
def test_blenders_sheet_is_where_blender_has_it(module, name, up):
    if module is usd:
        pytest.importorskip("pxr", reason="usd-core is not installed")
    found = module.read(BLENDER / name)
    expected = sheet() if up == "z" else y_up(sheet())
    assert found.axes == Axes(up, "right", 1.0)
    np.testing.assert_allclose(found.times - found.times[0], np.arange(5) / 25, atol=1e-7)
    np.testing.assert_allclose(found.positions, expected, atol=SINGLE)
    upward = normals(found.positions[0], found.triangles)[:, "xyz".index(up)]
    np.testing.assert_allclose(upward, 0.5, atol=1e-6)  # two sides of 0.5 and 1
    assert len(found.triangles) == 8
    assert found.notes == ()
    x, y = (1 - expected[0] @ np.eye(3)[0]) / 2, expected[0] @ np.eye(3)[1 if up == "z" else 2]
    y = (y - 2) if up == "z" else (-y - 2)
    corners = np.stack([y, x], axis=-1)[found.triangles]
    image = found.texture * [1, -1] + [0, 1] if module is glb else found.texture  # glTF counts v from above
    np.testing.assert_allclose(image, corners, atol=1e-6)


@pytest.mark.parametrize("name", ["sheet-text.stl", "sheet-binary.stl"])
def test_blenders_stl_is_the_sheet_with_its_corners_joined(name):
    found = stl.read(BLENDER / name)
    assert found.positions.shape == (1, 9, 3)
    assert found.triangles.shape == (8, 3)
    np.testing.assert_allclose(in_order(found.positions[0]), in_order(sheet()[0]), atol=SINGLE)
    np.testing.assert_allclose(normals(found.positions[0], found.triangles)[:, 2], 0.5, atol=1e-6)


@pytest.mark.slow
def test_blend_shapes_of_usd_are_refused_with_what_to_do():
    pytest.importorskip("pxr", reason="usd-core is not installed")
    with pytest.raises(InvalidMotion, match=r"blend shapes move .*; bake the motion into its points, as Blender does"):
        usd.read(BLENDER / "shape-keys.usdc")


def shared(name):
    if not (SHARED / name).exists():
        pytest.skip(f"{SHARED / name} is not there")
    return SHARED / name


# trimesh's models, MIT: a cube of side 2, whose faces have materials of three colours, and other cubes
def test_a_text_gltf_with_its_numbers_in_it_and_several_primitives():
    found = glb.read(shared("cube.gltf"))
    assert found.positions.shape == (1, 24, 3)
    np.testing.assert_array_equal(np.abs(found.positions), 1)
    assert [(name, len(own)) for name, own in found.parts] == [("Green", 8), ("Blue", 8), ("Red", 8)]
    outward = np.einsum(
        "ij,ij->i", normals(found.positions[0], found.triangles), found.positions[0, found.triangles[:, 0]]
    )
    np.testing.assert_allclose(outward, 4, rtol=1e-12)  # twice the area 2 times the distance 1: 12 of them


@pytest.mark.parametrize(
    ("name", "vertices", "triangles", "area"),
    [("cube.stl", 132, 260, 2499.0248765768843), ("unit-cube.stl", 8, 12, 6.0)],
)
def test_stl_files_have_the_vertices_and_the_area_that_trimesh_finds(name, vertices, triangles, area):
    found = stl.read(shared(name))
    assert (found.positions.shape[1], len(found.triangles)) == (vertices, triangles)
    half = np.linalg.norm(normals(found.positions[0], found.triangles), axis=1).sum() / 2
    assert half == pytest.approx(area, rel=1e-9)  # sums of some hundred numbers, in another order


# pyomeca's test data, Apache-2.0
def test_the_trajectories_of_vicon_nexus():
    found = markers.read(shared("vicon-trajectories.csv"))
    assert found.axes == Axes("z", "right", 0.001)
    assert found.positions.shape == (61, 51, 3)
    assert found.names[:2] == ("boite:gauche_ext", "boite:gauche_int")
    np.testing.assert_array_equal(found.positions[0, :2], [[44.1628, -276.862, 675.697], [32.5723, -243.141, 676.575]])
    np.testing.assert_allclose(found.times, np.arange(61) / 100, rtol=1e-15)


def test_a_trc_file_with_commas_that_ends_early(tmp_path):
    path = shared("commas.trc")
    found = markers.read(path)
    assert found.notes == ("it ends early: 652 frames are promised, 54 are there",)
    assert found.positions.shape == (54, 51, 3)
    assert found.names[:3] == ("ASISl", "ASISr", "PSISl")
    np.testing.assert_array_equal(found.positions[1, 0], [733.4084, 81.0119, 191.8306])
    np.testing.assert_allclose(found.times, np.arange(54) / 100, atol=1e-12)  # text with two decimals
    (tmp_path / "cut.trc").write_text(path.read_text().rstrip()[:-2])  # a last number that is cut would be another one
    np.testing.assert_array_equal(markers.read(tmp_path / "cut.trc").positions, found.positions[:53])


def test_buffers_beside_a_gltf_are_read_in_its_folder_and_nowhere_else(tmp_path):
    folder = tmp_path / "own"
    folder.mkdir()
    for name in ("sheet.gltf", "sheet.bin"):
        shutil.copy(BLENDER / name, folder)
    text = (folder / "sheet.gltf").read_text()
    (folder / "parts").mkdir()
    (folder / "sheet.bin").rename(folder / "parts" / "a b.bin")
    (folder / "sheet.gltf").write_text(text.replace('"sheet.bin"', '"parts/a%20b.bin"'))
    np.testing.assert_allclose(glb.read(folder / "sheet.gltf").positions, y_up(sheet()), atol=SINGLE)
    shutil.copy(BLENDER / "sheet.bin", tmp_path / "sheet.bin")
    (folder / "linked.bin").symlink_to(tmp_path / "sheet.bin")
    far = ["../sheet.bin", "..%2Fsheet.bin", str(tmp_path / "sheet.bin"), "linked.bin", "", "\\u0000"]
    for uri in [*far, "file:///etc/passwd", "http://localhost/sheet.bin"]:
        (folder / "sheet.gltf").write_text(text.replace('"sheet.bin"', f'"{uri}"'))
        with pytest.raises(InvalidMotion, match=r"is not a file in its folder; export as .glb"):
            glb.read(folder / "sheet.gltf")
    (folder / "sheet.gltf").write_text(text)
    with pytest.raises(InvalidMotion, match=r"its numbers are in .sheet.bin., which is not there; copy it beside"):
        glb.read(folder / "sheet.gltf")


# Alembic: transforms, and files that are damaged. Blender's files: test_other_programs.


TRANSLATE, SCALE, ROTATE, MATRIX, ROTATE_X, ROTATE_Y, ROTATE_Z = 1, 0, 2, 3, 4, 5, 6


# Points are row vectors: they are multiplied by the last operation first. A quarter about z takes x to y.
def test_operations_apply_from_the_last_to_the_first():
    values = np.array([1.0, 2, 3, 90, 2, 3, 4])
    matrix = alembic._product(np.array([TRANSLATE, ROTATE_Z, SCALE]), values)
    np.testing.assert_allclose([1, 1, 1, 1] @ matrix, [1 - 3, 2 + 2, 3 + 4, 1], atol=1e-15)


@pytest.mark.parametrize(("code", "axis"), [(ROTATE_X, 0), (ROTATE_Y, 1), (ROTATE_Z, 2)])
def test_turns_about_an_axis_are_turns_about_the_same_given_axis(code, axis):
    one, other = alembic._product(np.array([code]), np.array([37.0])), 5.0 * np.eye(3)[axis]
    np.testing.assert_allclose(one, alembic._product(np.array([ROTATE]), np.array([*other, 37.0])), atol=1e-15)
    np.testing.assert_allclose(one, alembic._product(np.array([MATRIX]), one.reshape(-1)), atol=0)
    following = np.eye(4)[(axis + 1) % 3] @ one  # x to y, y to z, z to x, by 37 degrees
    assert following[(axis + 2) % 3] == pytest.approx(np.sin(np.radians(37)), rel=1e-14)
