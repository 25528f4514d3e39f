"""Joints of animations: what Blender says of the bones of an arm, and what its files of the same arm give."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.scene_files import container
from helpers.scenes import cloth, document

from clothfit import InvalidInput, InvalidMotion, InvalidScene, load
from clothfit.engine.inputs.sampling import paths, poses
from clothfit.evaluation.forecast import check_inputs, inputs_of
from clothfit.formats import joints
from clothfit.formats.axes import RIGHT, Axes

FOLDER = Path(__file__).parent / "blender"
ARM = json.loads((FOLDER / "arm.json").read_text())
TIMES = np.array(ARM["times"])
CLOSE = 2e-6
"""m, and of the parts of a rotation: files have numbers of 32 bits, and their products some more rounding."""


@pytest.fixture(params=["arm.glb", pytest.param("arm.usdc", marks=pytest.mark.slow)])  # a process reads USD
def path(request):
    if request.param.endswith("usdc"):
        pytest.importorskip("pxr", reason="needs usd-core")
    return FOLDER / request.param


def of_blender(bone):
    """Its matrices (K, 4, 4) in the scene's axes: Blender's z is up, right-handed; the scene's y, left-handed."""
    flip = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    return flip @ np.array(ARM["bones"][bone]) @ np.linalg.inv(flip)


@pytest.mark.parametrize("bone", ["upper", "lower"])
def test_a_point_on_a_bone_goes_where_blender_takes_it(path, bone):
    found = joints.read(path, bone)
    places, turns = found.moved(found.axes)
    at = [int(np.argmin(abs(found.times - time))) for time in TIMES]
    np.testing.assert_allclose(found.times[at], TIMES, atol=1e-6)
    true = of_blender(bone)
    np.testing.assert_allclose(places[at], true[:, :3, 3], atol=CLOSE)
    since = turns[at] @ turns[at[0]].T  # how a file's bone lies in its own axes differs from program to program
    np.testing.assert_allclose(since, true[:, :3, :3] @ true[0, :3, :3].T, atol=CLOSE)


def test_a_pin_and_a_collider_are_rigid_on_a_joint(path):
    keys = {"posKeys": {"file": str(path), "joint": "lower"}, "rotKeys": {"file": str(path), "joint": "lower"}}
    capsule = {"type": 2, "pos": {"x": -1.2, "y": 1.3, "z": 0.4}, "scale": {"x": 0.1, "y": 0.3, "z": 0.1}, **keys}
    made = load(document(cloth(pins=[{"vertices": [0, 3], **keys}]), colliders=[capsule]))
    true = of_blender("lower")
    motion = true @ np.linalg.inv(true[0])  # of the space that is fixed to the bone
    _, found = paths(made.cloths[0], TIMES)
    start = made.cloths[0].positions[[0, 3]]
    expected = np.einsum("tij,pj->tpi", motion[:, :3, :3], start) + motion[:, None, :3, 3]
    far = 1 + np.abs(expected).max()  # vertices are metres away from the joint: errors of angles count by that
    np.testing.assert_allclose(found, expected, atol=2 * far * CLOSE)
    centres, turns = poses(made.colliders, TIMES)
    np.testing.assert_allclose(centres[:, 0], motion[:, :3, :3] @ made.colliders[0].centre + motion[:, :3, 3],
                               atol=2 * far * CLOSE)  # fmt: skip
    np.testing.assert_allclose(turns[:, 0], motion[:, :3, :3], atol=CLOSE)
    assert len(inputs_of(made)) == 4


def glb(tmp_path, root):
    """A GLB file of a document without numbers."""
    (tmp_path / "made.glb").write_bytes(container({"asset": {"version": "2.0"}, **root}))
    return tmp_path / "made.glb"


def test_a_joint_below_others_that_stand_still_has_one_place(tmp_path):
    half = np.sqrt(0.5)
    nodes = [
        {"name": "hips", "children": [1], "translation": [1, 2, 3], "rotation": [0, half, 0, half],
         "scale": [2, 2, -2]},
        {"name": "knee", "translation": [0, -1, 0.5]},
    ]  # fmt: skip
    found = joints.read(glb(tmp_path, {"nodes": nodes}), "knee")
    places, turns = found.moved(RIGHT._replace(scale=0.01))
    # a quarter about y takes z to x: (0, −2, −1) to (−1, −2, 0); x is negated in the scene
    np.testing.assert_allclose(places, [[-0.0, 0.0, 0.03]], atol=1e-15)
    assert np.linalg.det(turns[0]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("root", "message"),
    [
        ({"nodes": [{"name": "hips"}, {"name": "head"}]}, "there is no joint knee; there are hips, head"),
        ({"nodes": [{"name": "knee"}, {"name": "knee"}]}, "2 joints are named knee"),
        ({"nodes": []}, "there is no joint knee; it names none"),
        ({"nodes": [{"name": "knee", "children": [0]}]}, "its nodes are not a tree"),
        ({"nodes": [{"name": "knee"}], "animations": [{"channels": [{"target": {"node": 0, "path": "rotation"}}]}]},
         r"animations\[0\].samplers"),
    ],
)  # fmt: skip
def test_what_is_no_joint_says_why(tmp_path, root, message):
    with pytest.raises(InvalidMotion, match=message):
        joints.read(glb(tmp_path, root), "knee")


def test_what_lacks_the_joint_or_has_none_says_so(path, tmp_path):
    with pytest.raises(InvalidMotion, match="there is no joint hand"):
        joints.read(path, "hand")
    (tmp_path / "a.pc2").write_bytes(b"")
    with pytest.raises(InvalidInput, match=r"joints are in \.glb, \.gltf and \.usd files"):
        joints.read(tmp_path / "a.pc2", "knee")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"file": "arm.glb", "joint": "hand"}, r"objects\[0\].pins\[0\].posKeys.file: arm.glb: there is no joint hand"),
        ({"file": "arm.glb", "joint": "lower", "points": [1]}, "has both points and a joint"),
        ({"file": "arm.glb", "joint": "lower", "fps": 25}, "its keys have times"),
        ({"file": "arm.glb", "joint": 3}, "posKeys.joint"),
    ],
)
def test_faults_of_a_scene_have_a_place(keys, message, tmp_path):
    if "file" in keys:
        keys = {**keys, "file": str(FOLDER / keys["file"])}
    with pytest.raises(InvalidScene, match=message):
        check_inputs(load(document(cloth(pins=[{"vertices": [0], "posKeys": keys}]))))


def test_axes_that_the_scene_names_go_before_those_of_the_file():
    found = joints.read(FOLDER / "arm.glb", "upper")
    places, turns = found.moved(Axes("z", "left", 2.0))
    plain, _ = found.moved(Axes("y", "left", 1.0))
    np.testing.assert_allclose(places, 2.0 * np.stack([plain[:, 0], plain[:, 2], -plain[:, 1]], axis=1), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
