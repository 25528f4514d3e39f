"""Motions of a mesh that was welded: read by the mesh's numbers, and written with them again."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from clothfit import InvalidMotion, load, load_motion, save_motion, simulate
from clothfit.cli.program import run
from clothfit.formats.registry import foreign, module_of
from clothfit.meshes import mesh
from clothfit.meshes.mesh import read_mesh
from clothfit.motion.files import for_tools
from clothfit.scene.mesh_numbering import numberings

pytestmark = pytest.mark.slow  # compiles a fit

FLOAT32 = 1e-6  # m, of positions of a few metres in single precision


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`sheet.obj`, a sheet whose triangles share no vertices, with one stray vertex, and `sheet.json` made of it."""
    found = tmp_path_factory.mktemp("welded")
    sheet = mesh.plane(2, 1.0)
    points = np.vstack([sheet.positions[sheet.triangles.reshape(-1)], [[5.0, 5, 5]]]) * [-1, 1, 1]
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    rows += ["f {} {} {}".format(*face) for face in (1 + np.arange(54).reshape(-1, 3))[:, ::-1].tolist()]
    (found / "sheet.obj").write_text("\n".join(rows))
    asked = ["--weld", "--fix-side", "left", "--frames", "6", "-o", str(found / "sheet.json"), "-q"]
    assert run(["new", str(found / "sheet.obj"), *asked]) == 0
    return found


@pytest.fixture
def scene(folder, monkeypatch):
    """The scene, whose 16 vertices were the mesh's 55."""
    monkeypatch.chdir(folder)
    found = load("sheet.json")
    assert (found.vertex_counts, len(numberings(found)[0])) == ((16,), 55)
    return found


def read_points(name):
    return module_of(foreign(name)).read(name).positions.shape[1]


@pytest.mark.parametrize("name", ["m.pc2", "m.mdd", "m_*.obj", "m.glb"])
def test_what_is_written_has_the_meshs_vertices_and_is_read_by_them(scene, name):
    motion = simulate(scene)
    save_motion(motion, name, scene)
    assert read_points(name) == 55
    again = load_motion(name, scene)
    np.testing.assert_allclose(again.positions, motion.positions, rtol=0, atol=20 * FLOAT32)  # .glb: to 1e-5 m
    assert again.vertex_counts == (16,)


def test_each_vertex_of_the_mesh_goes_with_the_one_it_became(scene):
    motion = simulate(scene)
    whole, faces = for_tools(motion, scene, foreign("m.pc2"))
    (numbering,) = numberings(scene)
    np.testing.assert_array_equal(whole.positions[:, :54], motion.positions[:, numbering[:54]])
    np.testing.assert_array_equal(numbering[faces], scene.cloths[0].triangles)
    np.testing.assert_allclose(whole.positions[0, :54], read_mesh("sheet.obj")[0].positions[:54], rtol=0, atol=1e-15)
    solid = trimesh.Trimesh(whole.positions[0], faces, process=False)
    assert solid.area == pytest.approx(1.0, rel=1e-12)  # m²


def test_a_fit_to_a_motion_of_the_mesh(scene, capsys):
    assert run(["target", "sheet.json", "-o", "t.pc2", "-q"]) == 0
    assert read_points("t.pc2") == 55
    few = ["--max-evaluations", "3", "--no-intervals"]
    assert run(["estimate", "sheet.json", "--target", "t.pc2", "--start", "20", *few, "--json"]) == 0
    err = capsys.readouterr().err
    assert "its vertices are those of the mesh before welding to 16" in err
    fitted = load("sheet.fitted.json")
    np.testing.assert_array_equal(numberings(fitted)[0], numberings(scene)[0])


def test_to_npz_and_back_to_the_mesh_and_markers_keep_the_numbers_of_the_scene(scene):
    motion = simulate(scene)
    save_motion(motion, "m.npz")
    assert run(["convert", "m.npz", "m.pc2", "--scene", "sheet.json", "--mesh", "sheet.obj", "-q"]) == 0
    assert run(["convert", "m.pc2", "again.npz", "--scene", "sheet.json", "-q"]) == 0
    save_motion(motion, "m.trc", scene)
    assert (read_points("m.pc2"), read_points("m.trc")) == (55, 16)
    for name in ("again.npz", "m.trc"):
        np.testing.assert_allclose(load_motion(name, scene).positions, motion.positions, rtol=0, atol=FLOAT32)


def test_another_count_is_refused(scene):
    motion = simulate(scene)
    save_motion(motion, "m.pc2")  # without the scene: 16 vertices, which fit as well
    assert load_motion("m.pc2", scene).vertex_counts == (16,)
    save_motion(replace(motion, positions=motion.positions[:, :9], vertex_counts=(9,)), "few.pc2")
    with pytest.raises(InvalidMotion, match=r"has 9 vertices, sheet\.json has 16"):
        load_motion("few.pc2", scene)
