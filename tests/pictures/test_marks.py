"""What pictures of controlled motions show: the key that comes next, forces as arrows, distances from the keys."""

import io

import numpy as np
import pytest
from helpers.physics import chain, scene, thing, xyz
from helpers.scenes import cloth

from clothfit.control.control import course
from clothfit.control.keyframes import Key
from clothfit.motion.simulate import simulate
from clothfit.pictures import gif
from clothfit.pictures.plots import chosen
from clothfit.pictures.stage import LONGEST, MOST_ARROWS, arrows, marks, stage
from clothfit.scene.forces import Forces

Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed; no animation is drawn")

STEPS, H = 20, 0.02


@pytest.fixture(scope="module")
def own():
    """A hanging cloth that forces in x push, twice as much at the end; keys in part, of a mean and of all."""
    made = scene(cloth(), delta=H, optimizationIterations=STEPS + 1)
    u = np.zeros((STEPS, 12, 3))
    u[:, 5:, 0] = np.linspace(0.1, 0.2, STEPS)[:, None]
    pushed = made.with_forces(Forces(H * np.arange(STEPS), u))
    motion = simulate(pushed)
    x = motion.positions
    keys = [
        Key(8, 0, np.array([6, 7], np.int32), x[8, [6, 7]] + [0, 0.3, 0.4]),
        Key(8, 0, np.arange(12, dtype=np.int32), np.array([[0.0, 1.0, 0.0]]), share=np.full(12, 1 / 12)),
        Key(20, 0, np.arange(12, dtype=np.int32), x[20]),
    ]
    return course(made, pushed, keys, motion), x, u


def test_the_course_beside_its_keys(own):
    found, x, u = own
    assert found.due.tolist() == [8, 20]
    assert [found.next(frame) for frame in (0, 8, 9, 20)] == [0, 0, 1, 1]
    assert np.isnan(found.poses[0]).any(axis=1).sum() == 10
    np.testing.assert_array_equal(found.poses[1], x[20])
    assert found.distance[0, 8] == pytest.approx(0.5, rel=1e-12)
    mean = x.mean(axis=1) - [0.0, 1.0, 0.0]
    np.testing.assert_allclose(found.distance[1], np.linalg.norm(mean, axis=1), rtol=1e-12)
    assert found.distance[2, 20] == 0.0 < found.distance[2, :20].min()
    assert found.effort.sum() == pytest.approx(H * (u**2).sum(), rel=1e-12)
    assert found.effort[-1] == 0.0  # nothing begins at the last frame
    assert np.abs(found.free[1:] - x[1:]).max() > 1e-4


def test_the_marks_of_each_frame_are_within_the_picture(own):
    found, x, _ = own
    made = marks(found)
    size = np.linalg.norm(np.ptp(x[0], axis=0))
    lengths = np.linalg.norm(made.arrows, axis=2)
    assert lengths.max() == pytest.approx(LONGEST * size)
    assert lengths[0, 6] == pytest.approx(0.5 * LONGEST * size)
    assert not made.arrows[:, :5].any()
    np.testing.assert_array_equal(made.keys[8], found.poses[0])
    np.testing.assert_array_equal(made.keys[9], found.poses[1])
    assert [len(each) for each in made.dots] == [1] * 9 + [0] * 12
    assert made.largest == pytest.approx(0.2)
    on = stage(found.scene, [x, *made.seen(x)], 100, times=found.times)
    for frame in range(STEPS):
        for ends in arrows(on, frame, x[frame], made):
            assert ((ends > on.camera.low) & (ends < on.camera.high)).all()


def test_no_more_arrows_than_can_be_told_apart_and_none_without_forces():
    many = scene(chain(3 * MOST_ARROWS, "nn"), delta=H, optimizationIterations=2)
    pushed = many.with_forces(Forces(np.zeros(1), np.ones((1, 3 * MOST_ARROWS, 3))))
    x = many.cloths[0].positions
    keys = [Key(1, 0, np.arange(len(x), dtype=np.int32), x)]
    made = marks(course(many, pushed, keys, simulate(pushed)))
    assert 0.5 * MOST_ARROWS < made.arrows[0].any(axis=1).sum() <= MOST_ARROWS
    still = scene(thing([(0, 0, 0)]), delta=H, optimizationIterations=3, gravity=xyz((0, 0, 0)))
    motion = simulate(still)
    made = marks(course(still, still, [Key(2, 0, np.zeros(1, np.int32), np.ones((1, 3)))], motion))
    assert not made.arrows.any()
    assert [name for name, _ in made.legend] == ["key", "cloth"]


def test_a_film_holds_the_keys(own):
    found, *_ = own
    made = marks(found)
    cut = gif.film(found.times, [7, 20])
    assert 7 in cut.frames  # every second one is shown otherwise
    waits = dict(zip(cut.frames, cut.durations, strict=True))
    assert waits[7] - waits[2] == pytest.approx(1000 * gif.LAST_FRAME_PAUSE, abs=200)  # a motion this short is slowed
    plain = gif.animation(found.scene, found.times, found.own, made.keys, 200)
    drawn = gif.animation(found.scene, found.times, found.own, made.keys, 200, made)
    first = [np.array(Image.open(io.BytesIO(each)).convert("RGB")).astype(int) for each in (plain, drawn)]
    red = [((each[:, :, 0] - each[:, :, 2] > 120) & (each[:, :, 1] > 50)).sum() for each in first]
    assert red[1] > 15 + 5 * red[0]  # arrows


@pytest.mark.quick
def test_a_strip_shows_the_keys():
    assert chosen(101) == [0, 20, 40, 60, 80, 100]
    assert chosen(101, [50, 100]) in ([0, 20, 50, 60, 80, 100], [0, 20, 40, 50, 80, 100])
    assert set(chosen(101, [3, 4, 5])) >= {3, 4, 5}
    assert chosen(101, list(range(1, 90))) == chosen(101)
    assert chosen(2, [1]) == [0, 1]
