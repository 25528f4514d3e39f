"""Simulating a scene, and reading and writing motions: every message, every kind of file."""

import io
import pickle

import numpy as np
import pytest
from helpers.paths import SHARED
from helpers.physics import METHODS, ball, scene, thing, xyz
from helpers.scenes import cloth

import clothfit.scene.scene
from clothfit import Diverged, InvalidInput, InvalidMotion, simulate
from clothfit.motion.motion import Motion, as_motion, check_motion, load_motion, save_motion

TWO = scene(cloth(2, 2), cloth(3, 2), optimizationIterations=4)
COUNTS = (4, 6)
RNG = np.random.default_rng(9)


def walk(observed=None):
    return Motion(RNG.normal(size=(4, 10, 3)), 0.02 * np.arange(4), COUNTS, observed, "walk")


def written(**arrays):
    """An archive of these arrays, ready to be read."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    file.seek(0)
    return file


def reread(motion):
    file = io.BytesIO()
    save_motion(motion, file)
    return load_motion(io.BytesIO(file.getvalue()), TWO)


# Simulation -----------------------------------------------------------------------------------------------------------


def test_a_simulation_has_the_frames_times_and_counts_of_the_scene():
    motion = simulate(TWO)
    assert motion.positions.shape == (4, 10, 3)
    np.testing.assert_allclose(motion.times, [0, 0.02, 0.04, 0.06], rtol=1e-15)  # one product each
    assert motion.vertex_counts == COUNTS
    assert motion.observed is None
    assert motion.remedies.direct_solves == 0
    start = np.concatenate([c.positions for c in TWO.cloths])
    np.testing.assert_array_equal(motion.positions[0], start)
    assert simulate(TWO, frames=2).positions.tolist() == motion.positions[:2].tolist()
    assert simulate(TWO, frames=1).positions.tolist() == [start.tolist()]
    with pytest.raises(InvalidInput, match=r"^frames must be at least 1 \(the initial state\); 0 was given$"):
        simulate(TWO, frames=0)


@pytest.mark.parametrize("method", list(METHODS))
def test_a_cloth_moves_as_if_it_were_alone(method):
    objects = [cloth(3, 2, dragCoefficient=0.3), cloth(2, 2), cloth(2, 3, damping=0.4)]
    fields = {"integrationMethod": METHODS[method], "windVel": xyz((1, 2, 3)), "colliders": [ball((1, -0.6, 1), 0.7)]}
    fields |= {"optimizationIterations": 8, "delta": 0.002}
    together = simulate(scene(*objects, **fields))
    for i, one in enumerate(objects):
        np.testing.assert_array_equal(together.of(i), simulate(scene(one, **fields)).positions)


def test_the_tolerance_of_the_scene_holds_unless_another_is_given():
    rough, fine = (scene(cloth(3, 3), tolerance=tolerance, optimizationIterations=5) for tolerance in (1e-2, 1e-12))
    np.testing.assert_array_equal(simulate(rough, tolerance=1e-12).positions, simulate(fine).positions)
    assert np.abs(simulate(rough).positions - simulate(fine).positions).max() > 0


def test_steps_with_a_matrix_that_is_not_positive_definite_are_counted():
    # a chain of heavy masses on short soft springs stands on a fixed vertex: h² load / length exceeds the masses
    points = [(1e-5 * (i % 2), 0.01 * i, 0) for i in range(8)]
    links = [(i, i + 1) for i in range(7)]
    column = thing(points, links, mass=0.01, stiffness=200.0, fixed=[0])
    motion = simulate(scene(column, optimizationIterations=30))
    assert motion.remedies.clamped_steps > 0
    assert motion.remedies.direct_solves == 0
    assert np.isfinite(motion.positions).all()


STIFF = thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=0.5, stiffness=2e4, fixed=[0])
FALLING = thing([(0, 0, 0)])


# ω = √(k/m) = 200 rad/s, so 2/ω = 10 ms; see `stability_limit`
LIMITS = {"explicit": "without damping they gain energy however short they are", "symplectic": "the limit is 0.01 s"}


@pytest.mark.parametrize("method", LIMITS)
def test_a_simulation_that_diverges_says_where_and_keeps_what_is_good(method):
    made = scene(FALLING, STIFF, integrationMethod=METHODS[method], delta=0.1, optimizationIterations=60)
    with pytest.raises(Diverged) as caught:
        simulate(made)
    error = caught.value
    assert error.exit_code == 4
    assert 2 < error.step < 60
    length = -error.motion.positions[:, 2, 1]  # m, 1 at rest, and the only spring
    begins = np.flatnonzero(np.abs(length) <= 10)[-1] + 1
    assert begins < error.step - 1
    assert str(error) == (
        f"scene: the simulation diverged at step {error.step} (t = {error.step * 0.1:.4g} s), "
        f"objects[1], vertex 1 of 2; from step {begins} on springs are more than 10 times as long as at rest; "
        f"try a smaller delta ({method} steps: {LIMITS[method]}) or integrationMethod 2 (implicit)"
    )
    assert error.motion.positions.shape == (error.step, 3, 3)
    assert len(error.motion.times) == error.step
    assert np.isfinite(error.motion.positions).all()
    good = simulate(made, frames=error.step)
    np.testing.assert_array_equal(good.positions, error.motion.positions)


@pytest.mark.skipif(
    not (SHARED / "reference" / "side.npz").is_file(), reason="../shared with the reference motion is not there"
)
def test_the_reference_motion():
    with np.load(SHARED / "reference" / "side.npz", allow_pickle=False) as loaded:
        expected = loaded["positions"]
    motion = simulate(clothfit.scene.scene.load(SHARED / "scenes" / "side.txt"), frames=len(expected), tolerance=1e-9)
    distance = np.linalg.norm(motion.positions - expected, axis=2)
    # that engine keeps lengths and stiffnesses in single precision: 1e-7 m is what is left
    assert np.sqrt((distance**2).mean()) < 1e-6


# Parts and files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hidden", [False, True])
def test_round_trip_and_the_parts_of_the_objects(tmp_path, hidden):
    seen = RNG.random((4, 10)) < 0.5 if hidden else None
    motion = walk(seen)
    if hidden:
        motion.positions[~seen] = np.nan
    np.testing.assert_array_equal(motion.of(0), motion.positions[:, :4])
    np.testing.assert_array_equal(motion.of(1), motion.positions[:, 4:])
    np.testing.assert_array_equal(motion.seen(1), seen[:, 4:] if hidden else np.ones((4, 6), bool))
    save_motion(motion, tmp_path / "walk.npz")
    back = load_motion(tmp_path / "walk.npz", TWO)
    for name in ("positions", "times", "observed"):
        np.testing.assert_array_equal(getattr(back, name), getattr(motion, name))
    assert (back.vertex_counts, back.name) == (COUNTS, "walk.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["walk.npz"]


@pytest.mark.parametrize("shape", [(10,), (4, 10)])
def test_weights_of_vertices_or_positions_are_kept(shape):
    weights = RNG.random(shape)
    motion = as_motion(TWO, walk().positions, weights=weights)
    np.testing.assert_array_equal(motion.weights, np.broadcast_to(weights, (4, 10)))
    np.testing.assert_array_equal(motion.weights_of(1), motion.weights[:, 4:])
    np.testing.assert_array_equal(reread(motion).weights, motion.weights)
    file = written(positions=motion.positions, weights=weights)
    np.testing.assert_array_equal(load_motion(file, TWO).weights, motion.weights)
    assert reread(walk()).weights is walk().weights_of(0) is None


def test_what_is_all_observed_needs_no_flags():
    motion = walk(np.ones((4, 10), bool))
    back = reread(motion)
    assert back.observed is None
    np.testing.assert_array_equal(back.positions, motion.positions)


class Pipe(io.BytesIO):
    """A stream that cannot go back."""

    def seekable(self):
        return False

    def seek(self, *_):
        raise io.UnsupportedOperation("seek")


def test_bare_positions_get_the_times_of_the_scene_and_other_arrays_are_left_alone(tmp_path):
    positions = walk().positions
    np.save(tmp_path / "walk.npy", positions)
    file = written(positions=positions, velocities=np.zeros(3))
    for each in (Pipe(file.getvalue()), file, tmp_path / "walk.npy"):
        motion = load_motion(each, TWO)
        np.testing.assert_array_equal(motion.positions, positions)
        np.testing.assert_allclose(motion.times, [0, 0.02, 0.04, 0.06], rtol=1e-15)  # one product each
        assert motion.vertex_counts == COUNTS
    for kind in (np.float32, np.int64, np.uint8):  # numbers of other types become doubles
        motion = load_motion(written(positions=np.full((2, 10, 3), 7, kind)), TWO)
        assert motion.positions.dtype == np.float64
        assert motion.positions.max() == 7


def good():
    return {"positions": walk().positions, "times": 0.02 * np.arange(4), "vertex_counts": np.array(COUNTS)}


def with_nan(value=np.nan):
    positions = walk().positions
    positions[2, 7, 1] = value
    return positions


UNSEEN = np.ones((4, 10), bool)
UNSEEN[2, 7] = False
INFINITE = "positions[2, 7]: is infinite, though not marked as unobserved"

BAD = [
    ({"positions": None}, "positions: is missing"),
    ({"positions": np.full((4, 10, 3), "a")}, "positions: has type <U1, numbers are needed"),
    ({"positions": np.zeros((4, 10, 3), complex)}, "positions: has type complex128, numbers are needed"),
    ({"positions": np.zeros((4, 9, 3))}, "positions: has shape (4, 9, 3), (frames, 10, 3) fits scene"),
    ({"positions": np.zeros((0, 10, 3))}, "positions: has shape (0, 10, 3), (frames, 10, 3) fits scene"),
    ({"positions": with_nan(np.inf)}, INFINITE),
    ({"vertex_counts": np.array([6, 4])}, "vertex_counts: is [6, 4], the scene has [4, 6]"),
    ({"vertex_counts": np.array(10)}, "vertex_counts: is [10], the scene has [4, 6]"),
    ({"times": np.arange(3.0)}, "times: has shape (3,) and type float64, 4 numbers, one per frame, fit; "
     "positions are (frames, vertices, 3)"),
    ({"times": np.array(list("abcd"))}, "times: has shape (4,) and type <U1, 4 numbers, one per frame, fit; "
     "positions are (frames, vertices, 3)"),
    ({"times": np.array([0, 1, 1, 2])}, "times: must be finite and increasing"),
    ({"times": np.array([0, 1, np.nan, 3])}, "times: must be finite and increasing"),
    ({"times": np.array([0, 1, 2, np.inf])}, "times: must be finite and increasing"),
    ({"observed": np.ones((4, 9), bool)}, "observed: has shape (4, 9) and type bool, (4, 10) bool fits"),
    ({"weights": np.ones(4)}, "weights: has shape (4,) and type float64, (10,) or (4, 10) numbers fit"),
    ({"weights": np.full(10, "a")}, "weights: has shape (10,) and type <U1, (10,) or (4, 10) numbers fit"),
    ({"weights": -UNSEEN.astype(int)}, "weights[0, 0] must be at least 0 and finite; -1 was given"),
    ({"weights": np.array([1.0] * 9 + [np.nan])}, "weights[9] must be at least 0 and finite; nan was given"),
    ({"weights": np.array([np.inf] + [1.0] * 9)}, "weights[0] must be at least 0 and finite; inf was given"),
    ({"observed": np.ones((4, 10))}, "observed: has shape (4, 10) and type float64, (4, 10) bool fits"),
]


@pytest.mark.parametrize(("change", "message"), BAD, ids=[message for _, message in BAD])
def test_each_fault_of_the_arrays_has_its_message(change, message):
    arrays = {key: value for key, value in {**good(), **change}.items() if value is not None}
    for read in (lambda: check_motion(arrays, TWO, "walk.npz"), lambda: load_motion(written(**arrays), TWO)):
        with pytest.raises(InvalidMotion) as caught:
            read()
        assert str(caught.value).split(": ", 1)[1] == message
        assert caught.value.exit_code == 3


def test_what_is_nan_was_not_observed():
    for more in ({}, {"observed": UNSEEN}, {"observed": np.ones((4, 10), bool)}):
        motion = check_motion(good() | {"positions": with_nan()} | more, TWO, "walk.npz")
        np.testing.assert_array_equal(motion.observed, UNSEEN)
        assert np.isnan(motion.positions[2, 7, 1])


# What is in a file, and a part of the message.
FILES = {
    "empty": (b"", "cannot be read as .npz or .npy ("),
    "pickle": (pickle.dumps({"positions": 1}), "cannot be read as .npz or .npy (it is neither)"),
    "no arrays": (b"PK\x05\x06" + bytes(18), "positions: is missing"),
    "none": (None, "there is no such file"),
    "folder": (..., "is a folder; name a motion file"),
}


@pytest.mark.parametrize("name", FILES)
def test_files_that_are_no_motions_are_refused(tmp_path, name):
    (data, message), path = FILES[name], tmp_path / "walk.npz"
    if data is ...:
        path.mkdir()
    elif data is not None:
        path.write_bytes(data)
    with pytest.raises(InvalidMotion) as caught:
        load_motion(path, TWO)
    assert str(caught.value).startswith(f"walk.npz: {message}")
    assert "\n" not in str(caught.value)


def test_a_motion_that_cannot_be_written_is_an_error_of_the_input(tmp_path):
    with pytest.raises(InvalidInput):
        save_motion(walk(), tmp_path / "none" / "walk.npz")
