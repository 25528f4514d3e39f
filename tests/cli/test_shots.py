"""A file with a cloth, a body that moves and a table: a scene is made of it and fitted, and a copy comes back."""

import json
import re
import shlex

import numpy as np
import pytest
from helpers.paths import ROOT
from pxr import Sdf, Usd, UsdGeom, Vt
from trimesh.creation import icosphere

from clothfit import load, mesh, simulate
from clothfit.cli.parts.new_shot import closed_up, without_folded
from clothfit.cli.program import run
from clothfit.engine.inputs.body_files import closed
from clothfit.formats import usd, usd_reader
from clothfit.scene.scene import save

pytestmark = pytest.mark.slow  # compiles a fit

RATE, FRAMES = 50, 24
SHEET = mesh.plane(5, 0.6)  # 7 × 7 vertices, the first row is 0 … 6; its plane is y = 0
SOLID = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
SWAY = 0.08 * np.sin(np.arange(FRAMES) / RATE * 6.0)[:, None, None] ** 2 * [1.0, 0.3, 0.0]


def of_file(points):
    """Points of the scene, m, in z up, right-handed and centimetres."""
    x, y, z = np.moveaxis(np.asarray(points), -1, 0)
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(100 * np.stack([-x, -z, y], axis=-1), np.float32))


def add(stage, name, faces, frames, pin=None):
    """A mesh below an object of its name, with a sample for each frame where there are several."""
    UsdGeom.Xform.Define(stage, f"/shot/{name}").AddTranslateOp().Set((10.0, 0.0, 5.0))
    made = UsdGeom.Mesh.Define(stage, f"/shot/{name}/Shape{name}")
    made.GetFaceVertexCountsAttr().Set([len(face) for face in faces])
    made.GetFaceVertexIndicesAttr().Set(np.ravel(faces).tolist())
    for k, frame in enumerate(frames):
        made.GetPointsAttr().Set(of_file(frame), *([k + 1] if len(frames) > 1 else []))
    if pin is not None:
        UsdGeom.PrimvarsAPI(made).CreatePrimvar("Pinned", Sdf.ValueTypeNames.FloatArray, "vertex").Set(pin)


def write(path, cloth, name="Cloth", **more):
    """A shot in which the cloth, of that name, has these frames."""
    stage = Usd.Stage.CreateNew(path)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(RATE)
    add(stage, name, SHEET.triangles, cloth, **more)
    add(stage, "Body", SIDES, 0.1 * SOLID + [0.0, -0.115, 0.1] + SWAY)
    add(stage, "Table", [[0, 1, 3, 2]], [np.array([[x, -0.3, z] for x in (-1, 1) for z in (-1, 1)], float)])
    stage.GetRootLayer().Save()


@pytest.fixture(autouse=True)
def _read_here(monkeypatch):
    """Files are read in this process, which is quicker; the other one that reads them otherwise: formats/test_usd."""

    def arrays_of(path, what="mesh", *more):
        return {name: np.asarray(each) for name, each in usd_reader.READ[what](str(path), str(path), *more).items()}

    monkeypatch.setattr(usd, "arrays_of", arrays_of)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a shot whose cloth is held by its first row."""
    monkeypatch.chdir(tmp_path)
    free = 0.01 * np.sin(np.arange(FRAMES))[:, None, None] * np.random.default_rng(0).normal(size=(49, 3))
    free[:, :7] = 0.0
    write("first.usda", SHEET.positions + free - free[0] + np.where(np.arange(49)[:, None] < 7, SWAY, 0.0))
    return tmp_path


NEW = ["--cloth", "Cloth", "--collider", "Body", "--collider", "Table", "--fit", "auto", "-q"]


def test_a_shot_gives_cloth_colliders_held_vertices_and_their_paths(folder):
    assert run(["new", "first.usda", *NEW, "--pins-from", "first.usda", "-o", "there/a.json"]) == 3  # no such folder
    assert run(["new", "first.usda", *NEW, "--pins-from", "first.usda", "-o", "a.json"]) == 0
    scene, document = load("a.json"), json.loads((folder / "a.json").read_text())
    own, (body, table) = document["objects"][0], document["colliders"]
    assert (scene.delta, scene.frames, own["meshName"], document["fit"]) == (1 / RATE, FRAMES, "Cloth", "auto")
    assert scene.cloths[0].fixed.nonzero()[0].tolist() == list(range(7))
    keys = {"file": "first.usda", "mesh": "Cloth", "points": list(range(7))}
    assert own["pins"] == [{"vertices": list(range(7)), "posKeys": keys}]
    shift = [-0.1, 0.05, 0.0]  # of their objects, from the file's axes
    np.testing.assert_allclose(scene.cloths[0].positions, SHEET.positions + shift, atol=1e-7)  # m, of single precision
    moved = np.load("a.Body.npz")["positions"]
    assert body["motion"] == {"file": "a.Body.npz"}
    np.testing.assert_allclose(moved, 0.1 * SOLID + [0.0, -0.115, 0.1] + SWAY + shift, atol=1e-7)
    assert "motion" not in table
    assert len(table["mesh"]["vertices"]) == 8  # with a back
    assert min(each["y"] for each in table["mesh"]["vertices"]) < -0.3  # below
    last = simulate(scene).positions[-1, :7]
    np.testing.assert_allclose(last, SHEET.positions[:7] + SWAY[-1] + shift, atol=1e-7)


def test_a_name_must_be_one_and_a_marked_vertex_is_held(folder, said):
    code, _, err = said("new first.usda --cloth Skirt")
    assert (code, err) == (3, "error: first.usda: there is no mesh Skirt in it; it has Cloth, Body, Table\n")
    code, _, err = said("new first.usda --collider Table")
    assert code == 2
    assert err.startswith("error: --cloth says which of Cloth, Body is the cloth; add it")
    write("pinned.usda", SHEET.positions + np.zeros((FRAMES, 1, 1)), pin=[0.5, *[0.0] * 47, 1.0])
    code, _, err = said("new pinned.usda --cloth Cloth")
    assert code == 0
    assert "its attribute Pinned holds 2 vertices" in err
    assert "fixed: 2 vertices (0, 48)" in err
    code, out, _ = said("info first.usda")
    assert "Cloth: 49 vertices, 72 faces, 24 frames, moves, held? 0-6 (as one)" in out
    assert "Body: 8 vertices, 12 faces, 24 frames, rigid" in out
    assert "Table: 4 vertices, 2 faces, 1 frame, still" in out


def test_two_commands_fit_a_shot_and_bring_it_back(folder, said):
    """Stiffness × 3 and damping × 5 off: found to 0.1 %, from numbers of single precision; within 0.1 mm."""
    assert run(["new", "first.usda", *NEW, "--pins-from", "first.usda", "-o", "a.json"]) == 0
    scene = load("a.json")
    (cloth,) = scene.cloths
    true = scene.with_values([cloth.mass], [3.0 * cloth.stiffness], damping=[5.0 * cloth.damping])
    save(true, "true.json")
    motion = simulate(true, FRAMES)
    write("shot.usda", motion.positions - [-0.1, 0.05, 0.0])
    assert run(["new", "shot.usda", *NEW, "-o", "mine.json"]) == 0
    code, out, _ = said("estimate mine.json --target shot.usda -o fitted.json --cache fitted.usda --json")
    assert code == 0
    found, (fitted,) = json.loads(out), load("fitted.json").cloths
    assert found["rmse"] < 1e-4
    assert found["pins"] == {"followed": 7}
    np.testing.assert_allclose(fitted.stiffness / cloth.stiffness, 3.0, rtol=1e-3)
    assert fitted.damping == pytest.approx(5.0 * cloth.damping, rel=1e-3)
    before, after = (Usd.Stage.Open(name) for name in ("shot.usda", "fitted.usda"))
    for prim in before.Traverse():
        other = after.GetPrimAtPath(prim.GetPath())
        assert other.GetTypeName() == prim.GetTypeName()
        if own := UsdGeom.Mesh(prim):
            codes, theirs = own.GetPointsAttr().GetTimeSamples(), UsdGeom.Mesh(other).GetPointsAttr()
            assert theirs.GetTimeSamples() == codes
            away = 1e-2 if prim.GetName() == "ShapeCloth" else 0.0  # cm, 0.1 mm
            np.testing.assert_allclose(theirs.Get(FRAMES), own.GetPointsAttr().Get(FRAMES), atol=away)


def test_the_commands_of_the_page_on_garments_run(folder):
    page = (ROOT / "docs" / "garment.md").read_text("utf-8")
    lines = "".join(re.findall(r"^```sh\n(.*?)^```", page, re.DOTALL | re.MULTILINE)).splitlines()
    falling = SHEET.positions + np.zeros((FRAMES, 1, 1)) + np.where(np.arange(49)[:, None] < 7, SWAY, 0.0)
    write("shot.usdc", falling, "Skirt")
    assert run(["new", "shot.usdc", "--cloth", "Skirt", "--collider", "Body", "--collider", "Table", "-q"]) == 0
    scene = load("shot.json")
    motion = simulate(scene.with_values([scene.cloths[0].mass], [2.0 * scene.cloths[0].stiffness]), FRAMES)
    (folder / "shot.usdc").unlink()
    write("shot.usdc", motion.positions - [-0.1, 0.05, 0.0], "Skirt")
    assert run(["convert", "shot.usdc", "render_*.obj", "--cloth", "Skirt", "--frames", ":1", "-q"]) == 0
    (folder / "render_0000.obj").rename("render.obj")
    assert len(lines) == 5
    for line in lines:
        assert run([*shlex.split(line)[1:], "-q"]) == 0
    assert {"fitted.usdc", "render.pc2", "skirt.pc2"} <= {each.name for each in folder.iterdir()}
    assert (folder / "fit.html").stat().st_size > 1e5


@pytest.mark.parametrize(("removed", "done"), [([0, 40], "2 holes are closed"), ([*range(120)], "has got a back")])
def test_narrow_holes_of_a_body_are_closed_and_wide_ones_get_a_back(removed, done):
    """The ball of 320 triangles moves and grows; lids are in the plane of the triangles that were there, so the volume
    is that of the whole one, but for rounding.
    """
    ball = icosphere(2)
    points, triangles = np.asarray(ball.vertices), np.asarray(ball.faces, np.int32)
    frames = np.stack([points, 2.0 * points + [1.0, 0.0, 0.0]])
    left = np.delete(triangles, removed, axis=0)
    every, made, how = closed_up(frames, mesh.Mesh(points, left))
    assert how == done
    closed(made)  # else it would raise
    if len(removed) == 2:
        a, b, c = np.moveaxis(every[:, made.triangles], 2, 0)
        volumes = np.linalg.det(np.stack([a, b, c], axis=2)).sum(axis=1) / 6
        np.testing.assert_allclose(volumes, [ball.volume, 8 * ball.volume], rtol=1e-12)


def test_triangles_that_lie_face_to_face_are_no_part_of_a_body():
    """Two quads that share two sides, cut along the line that they have in common, fold onto each other there."""
    folded = np.array([[0, 1, 2], [0, 2, 3], [4, 2, 1], [2, 0, 3], [4, 5, 6]], np.int32)
    assert without_folded(folded).tolist() == [[0, 1, 2], [4, 2, 1], [4, 5, 6]]
