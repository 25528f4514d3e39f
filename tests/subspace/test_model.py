"""From a scene to a model and back from its file; what it follows, clamps and refuses."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere
from helpers.subspaces import scene_of, whole

from clothfit.base.errors import InvalidInput
from clothfit.engine.system import build as build_system
from clothfit.subspace.build import CUBATURES, Options, build, coarsest
from clothfit.subspace.inputs import Ranges, applied, episodes
from clothfit.subspace.model import load_model, save
from clothfit.subspace.network.learn import training_data
from clothfit.subspace.physics.cubature import Found
from clothfit.subspace.physics.samples import Reduced
from clothfit.subspace.play import play
from clothfit.subspace.recording import Data, record

pytestmark = pytest.mark.slow  # compiles motions with inputs

FAR = sphere(0.1, pos={"x": 500.0, "y": 0.0, "z": 0.0}, friction=0.1)
"""What nothing touches: motions with colliders are compiled for other tests as well."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A model of a small cloth in gusts, and the data it was built of."""
    place = tmp_path_factory.mktemp("subspace")
    held = [i < 5 for i in range(25)]
    own = cloth(5, 5, damping=0.5, vertIsFixed=held)
    scene = scene_of(document(own, colliders=[FAR], optimizationIterations=60))
    ranges = Ranges(2.0)
    path = place / "data.npz"
    found = record(scene, episodes(scene, ranges, 5, 1.2, 0), ranges, 60, path)
    assert (found.left_out, found.diverged, found.frames) == (0, 0, 5 * 61)
    data = Data(path)
    return place, data, *build(data, Options(size=24))


def test_a_motion_that_it_was_not_built_of_is_followed(made):
    _, _, _, (report,) = made
    assert report.vectors == 24
    assert report.whole.relative < 0.03  # a cloth without bending springs crumples: 24 of its 60 coordinates miss that
    assert report.sampled.relative < 0.03
    assert report.left_out[16] > report.left_out[24] > 0
    assert max(report.errors.values()) <= max(CUBATURES)


def test_the_coarsest_cubature_is_taken_that_is_good_enough(made):
    _, data, model, _ = made
    basis, (x, _) = model.parts[0].basis, data.motion(0, 0)
    own = Reduced(build_system(data.scene_of(0), 0, steps=data.steps), basis)
    whole, last = Found(own.chosen, {}), Found(model.parts[0].chosen, {})
    poor = Found(type(own.chosen)(*(each[:1] for each in own.chosen)), {})
    assert coarsest(own, basis, [poor, whole, last], x) is whole
    assert coarsest(own, basis, [poor, poor, last], x) is last


def test_its_file_gives_the_same_motion_and_the_same_seed_the_same_data_and_model(made):
    place, data, model, _ = made
    save(model, place / "model.npz")
    both = [play(each, data.scene_of(4), 40).motion.positions for each in (model, load_model(place / "model.npz"))]
    np.testing.assert_array_equal(*both)
    again = place / "again.npz"
    record(data.scene, episodes(data.scene, data.ranges, 5, 1.2, 0), data.ranges, 60, again)
    np.testing.assert_array_equal(Data(again).motion(3, 0)[0], data.motion(3, 0)[0])
    other, _ = build(Data(again), Options(size=24))
    np.testing.assert_array_equal(other.parts[0].basis, model.parts[0].basis)
    np.testing.assert_array_equal(other.parts[0].chosen.spring_weight, model.parts[0].chosen.spring_weight)


def test_inputs_beyond_the_range_are_clamped_and_said_once_and_it_comes_to_rest_when_they_do(made):
    _, data, model, _ = made
    storm = [{"acts": "wind", "times": [0, 0.5, 3], "values": [[0, 0, 0], [0, 9e5, 0], [4e5, 0, 0]]}]
    played = play(model, applied(data.scene, storm), 120)
    assert len(played.clamped) == 1
    assert "wind leaves the range" in played.clamped[0]
    reach = np.abs(np.concatenate([data.motion(e, 0)[0] for e in range(4)])).max()
    moved = played.motion.positions - played.motion.positions[0]
    assert np.abs(moved).max() < 3 * reach  # pushed as hard as ever recorded, and for longer
    gust = [{"acts": "wind", "times": [0, 0.3, 0.6], "values": [[0, 0, 0], [4, 0, -4], [0, 0, 0]]}]
    played = play(model, applied(data.scene, gust), 1200)
    speed = np.abs(np.diff(played.motion.positions, axis=0)).max(axis=(1, 2))
    assert speed[-1] < 1e-6 * speed.max()  # damping of 0.5/s for 23 s, and that of the integrator
    assert play(model, data.scene_of(0), 20).clamped == []


def test_an_error_asks_for_as_many_vectors_as_it_needs_and_few_coordinates_need_few_elements(made):
    _, data, _, (before,) = made
    _, (found,) = build(data, Options(error=2 * before.left_out[16], cubature=()))
    assert 8 < found.vectors <= 16
    assert found.elements["springs"][0] == found.elements["springs"][1]
    _, (found,) = build(data, Options(size=6, cubature=(0.05,)))
    used = {kind: (few, there) for kind, (few, there) in found.elements.items() if there and kind != "vertices"}
    assert all(0 < few < 0.7 * there for few, there in used.values())
    assert max(found.errors.values()) <= 0.05


def test_files_that_are_none_are_refused(made, tmp_path):
    place, _, model, _ = made
    save(model, tmp_path / "m.npz")
    content = (tmp_path / "m.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(content[: len(content) // 2])
    (tmp_path / "other.npz").write_bytes((place / "data.npz").read_bytes())
    for name in ("half.npz", "other.npz", "none.npz"):
        with pytest.raises(InvalidInput, match=name):
            load_model(tmp_path / name)
    with pytest.raises(InvalidInput, match=r"m\.npz: it is no data"):
        Data(tmp_path / "m.npz")
    other = scene_of(document(cloth(3, 3)))
    with pytest.raises(InvalidInput, match="its objects are not those of the model"):
        play(model, other, 5)


# --- motions that come to rest go on where the recorded ones end, for networks

STEPS = 60


def lesson_of(tmp_path, **fields):
    """What recorded motions of a cloth in gusts teach a network on a basis of all motions."""
    made, ranges = document(cloth(4, 3, **fields), colliders=[FAR], optimizationIterations=STEPS), Ranges(3.0)
    scene = scene_of(made)
    record(scene, episodes(scene, ranges, 4, 1.2, 0), ranges, STEPS, tmp_path / "data.npz")
    return training_data(Data(tmp_path / "data.npz"), 0, range(4), whole(build_system(scene, 0, steps=1)))


def test_pieces_follow_the_recorded_frames_and_each_other(tmp_path):
    given = lesson_of(tmp_path, damping=2.0)
    count = len(given.rest.z) // 2  # of episodes 1 and 3
    for number, episode in enumerate((1, 3)):
        first = given.rest.z[number * count]
        # a basis of all motions: the same steps, but for the tolerance 1e-6 of their linear systems
        np.testing.assert_allclose(first[:2], given.motions.z[episode, -2:], atol=1e-4)
        for k in range(count - 1):
            piece, after = given.rest.z[number * count + k : number * count + k + 2]
            np.testing.assert_array_equal(piece[-2:], after[:2])
        speed = np.abs(np.diff(given.rest.z[number * count : (number + 1) * count], axis=1)).max(axis=(1, 2))
        assert speed[-1] < 1e-3 * speed[0]  # damping of 2/s for 10 s
    assert np.abs(given.rest.w[-1]).max() < 1e-12  # the wind is over


def test_a_cloth_that_falls_for_ever_has_none(tmp_path):
    """Nothing holds it: ten times as long, it would fall a hundred times as far as in the recorded frames."""
    assert lesson_of(tmp_path, vertIsFixed=[False] * 12).rest is None
