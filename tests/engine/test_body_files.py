"""Meshes of colliders from scenes and files: what is joined and turned, and which faults are named where."""

import json

import numpy as np
import pytest
from helpers.physics import scene, thing, xyz
from helpers.surfaces import block, body, sphere, torus

from clothfit import InvalidScene, load
from clothfit.engine.inputs.body_files import body_of
from clothfit.engine.inputs.sampling import arrays_from_files
from clothfit.evaluation.forecast import check_inputs, inputs_of
from clothfit.optimise.checkpoint import identity


def with_mesh(made, **fields):
    return scene(thing([(0, 0, 0)]), colliders=[body(made, **fields)])


def volume(surface):
    return np.linalg.det(surface.place[surface.triangles]).sum() / 6


def obj(path, made):
    """Write the mesh as an OBJ, whose first axis points the other way."""
    points, faces = made
    lines = ["v {!r} {!r} {!r}".format(*point) for point in (points * [-1, 1, 1]).tolist()]
    path.write_text("\n".join([*lines, *("f {} {} {}".format(*face) for face in (faces + 1).tolist())]))


@pytest.mark.parametrize("made", [block((1, 2, 3)), sphere(6), torus(8, 5)], ids=["block", "sphere", "torus"])
def test_behind_each_side_is_the_triangle_that_shares_it(made):
    points, faces = made
    for each in (faces, faces[:, ::-1]):  # those that face inward are turned
        surface = body_of(with_mesh((points, each)).colliders[0]).surface
        corners = points[faces]
        assert volume(surface) == pytest.approx(np.linalg.det(corners).sum() / 6)
        for side, (a, b) in enumerate([(0, 1), (1, 2), (2, 0)]):
            other, ends = surface.triangles[surface.across[:, side]], surface.triangles[:, [a, b]]
            assert (other[:, :, None] == ends[:, None]).any(axis=1).all()


def test_vertices_at_one_place_count_as_one():
    points, faces = block()
    made = with_mesh((points[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3)), scale=xyz((2, 1, 1)))
    surface = body_of(made.colliders[0]).surface
    assert len(surface.place) == 8
    assert volume(surface) == pytest.approx(2.0)


def test_a_file_is_read_into_the_axes_of_the_scene(tmp_path):
    points, faces = torus(8, 5)
    points = points + 0.1 * np.sin(3 * points[:, ::-1])
    obj(tmp_path / "ring.obj", (points, faces))
    item = {"type": 4, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1)), "mesh": "ring.obj"}
    text = {**json.loads(scene(thing([(0, 0, 0)])).source.text), "colliders": [item]}
    (tmp_path / "scene.json").write_text(json.dumps(text))
    surface = body_of(load(tmp_path / "scene.json").colliders[0]).surface
    np.testing.assert_allclose(surface.place, points, atol=1e-12)
    assert volume(surface) > 0


def test_a_motion_goes_with_the_mesh(tmp_path):
    points, faces = sphere(5)
    frames = points * np.array([1.0, 1.1, 1.3])[:, None, None]
    np.savez(tmp_path / "grow.npz", positions=frames, times=np.array([0, 0.5, 1.0]))
    file = {"file": str(tmp_path / "grow.npz")}
    made = with_mesh((points, faces), motion=file, scale=xyz((1, 2, 1)))
    own = body_of(made.colliders[0])
    np.testing.assert_allclose(own.frames, frames * [1, 2, 1])
    assert made.colliders[0].moves
    assert [str(each).split(":")[0] for each in inputs_of(made)] == ["colliders[0].motion"]
    first = identity(made, None, None)
    np.savez(tmp_path / "grow.npz", positions=1.01 * frames, times=np.array([0, 0.5, 1.0]))
    assert identity(made, None, None)["input files"] != first["input files"]


def test_a_scene_without_files_has_the_identity_that_it_had():
    made = with_mesh(block())
    assert arrays_from_files(made) == []
    assert "input files" not in identity(made, None, None)


POINTS, FACES = sphere(4)
HOLE, FLIPPED = FACES[1:], np.concatenate([FACES[:1, ::-1], FACES[1:]])
FLAT = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0)], float), np.array([(0, 1, 2)], np.int32)
BAD = {
    "open": (POINTS, HOLE, {}, "mesh: is not closed: 3 edges are sides of one triangle only, the first between"),
    "flipped": (POINTS, FLIPPED, {}, "mesh: at 3 edges two triangles face opposite ways, the first between"),
    "double": (POINTS, np.concatenate([FACES, FACES[:1]]), {}, "mesh: 3 edges are sides of more than two triangles"),
    "flat": (*FLAT, {}, "mesh: triangle 0 has no area"),
    "index": (POINTS, FACES + 1, {}, "mesh.triangles["),
    "none": (POINTS, FACES[:0], {}, "mesh: has no triangles"),
    "no file": (POINTS, FACES, {"mesh": "there is none.obj"}, "mesh: there is none.obj: there is no such file"),
    "no mesh": (POINTS, FACES, {"mesh": {}}, "mesh: needs a file, or vertices and triangles"),
    "both": (POINTS, FACES, {"mesh": {"file": "a.obj", "vertices": []}}, "mesh: needs a file, or vertices"),
    "number": (POINTS, FACES, {"mesh": 5}, "mesh: 5 is not text in quotes or an object"),
    "corners": (POINTS, FACES, {"mesh": {"vertices": [], "triangles": [1, 2]}}, "mesh.triangles: has 2 items; three"),
    "keys": (POINTS, FACES, {"motion": {"times": [0], "values": [xyz((0, 0, 0))]}}, "motion: needs the file of a"),
    "no motion": (POINTS, FACES, {"motion": {"file": "there is none.npz"}}, "motion.file: there is none.npz: there is"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_faults_are_named_with_their_place(name):
    points, faces, fields, said = BAD[name]
    with pytest.raises(InvalidScene) as caught:
        check_inputs(with_mesh((points, faces), **fields))
    assert any(problem.startswith(f"colliders[0].{said}") for problem in caught.value.problems)


@pytest.mark.parametrize(("change", "said"), [
    (lambda frames: frames[:, 1:], "motion.file: has 25 points for the 26 vertices of the mesh"),
    (lambda frames: frames * [[[1]], [[0]]], "motion.file: frame 1: triangle 0 of the mesh has no area"),
    (lambda frames: frames * np.nan, "motion.file: bad.npz: "),
])  # fmt: skip
def test_motions_that_do_not_fit_the_mesh(tmp_path, change, said):
    frames = change(np.repeat(POINTS[None], 2, axis=0))
    np.savez(tmp_path / "bad.npz", positions=frames, times=np.arange(2.0))
    with pytest.raises(InvalidScene) as caught:
        check_inputs(with_mesh((POINTS, FACES), motion={"file": str(tmp_path / "bad.npz")}))
    assert caught.value.problems[0].startswith(f"colliders[0].{said}")
