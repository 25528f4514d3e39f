"""Gradients through all steps of a window, the linear part, and trainings that stop and go on."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from clothfit.subspace.network.layers import OWN, Loss, Motions, Trained, dense, gradient, played
from clothfit.subspace.network.learn import TrainingData, finished, prepared
from clothfit.subspace.network.signals import Signals
from clothfit.subspace.network.training import Budget, Descent, archived, numbers, restore
from clothfit.subspace.network.weights import Room

pytestmark = pytest.mark.quick

R, M = 4, 2


def motions(episodes=9, frames=60, seed=0):
    """Coordinates of R damped oscillators that one input each pushes, the first one with a cubic spring."""
    rng = np.random.default_rng(seed)
    w = np.repeat(rng.uniform(-1, 1, (episodes, -(-frames // 8) + 1, M)), 8, axis=1)[:, :frames]
    z = np.zeros((episodes, frames + 2, R))
    stiffness = np.array([0.02, 0.05, 0.1, 0.2])
    for t in range(frames):
        now, way = z[:, t + 1], z[:, t + 1] - z[:, t]
        force = 0.1 * w[:, t, [0, 1, 0, 1]] - stiffness * now
        force[:, 0] -= 0.02 * now[:, 0] ** 3
        z[:, t + 2] = now + 0.95 * way + force
    return Motions(z, w, np.ones(z.shape[:2], bool))


def lesson(**kind):
    """These motions with their inputs as they are."""
    own = motions(**kind)
    signals = Signals((("wind", M),), np.zeros(M), np.eye(M))
    return TrainingData(own, signals, int(own.good[:, 1:].sum()))


def trained(limits=np.inf):
    """A network with few small layers in double precision, with all its values moved, so that all count."""
    given, rng = motions(), np.random.default_rng(2)
    reach = np.array([[-limits] * R, [limits] * R])
    small = dataclasses.replace(OWN, hidden=(2.0, 1.5))
    own = Trained(dense(given), small, reach, np.random.default_rng(1), np.float64)
    for each in own.values:
        each += 0.05 * rng.standard_normal(each.shape)
    return own, given


def test_the_gradient_through_a_window_is_that_of_differences():
    (own, given), loss = trained(), Loss(2.0)
    z, w = given.windows(given.starts(9)[0][::37], 9)
    rng = np.random.default_rng(3)
    begin = z[:, :2] + 0.1 * rng.standard_normal(z[:, :2].shape)
    error, grad = gradient(own, loss, z, w, begin)
    away = played(own, begin, w)[:, 1:] - z[:, 1:]
    sizes = [np.linalg.norm(x, axis=2) for x in (away[:, 1:], np.diff(away, axis=1))]
    assert error == pytest.approx(sizes[0].mean() + 2.0 * sizes[1].mean(), rel=1e-9)
    for value, by in zip(own.values, grad, strict=True):
        direction = rng.standard_normal(value.shape)
        found, eps = [], 1e-6
        for sign in (1, -1):
            value += sign * eps * direction
            found.append(gradient(own, loss, z, w, begin)[0])
            value -= sign * eps * direction
        # kinks of absolute values and of ReLU apart, which none of these seeds meets, central differences miss
        # 1e-12 of the third derivative, and rounding is 1e-16 / 1e-6
        np.testing.assert_allclose(np.vdot(by, direction), (found[0] - found[1]) / (2 * eps), rtol=1e-6, atol=1e-9)


def test_the_gradient_passes_a_clip_only_on_the_way_back():
    own, given = trained(limits=0.3)
    z, w = given.windows(given.starts(1)[0][::50], 1)
    after, kept = own.step(z[:, 1], z[:, 0], w[:, 0])
    above = after == 0.3
    assert above.any()
    for sign in (1.0, -1.0):  # a step against the gradient leads back into the range where it is positive
        grad = [np.zeros_like(each) for each in own.values]
        own.pull(kept, np.where(above, sign, 0.0), grad)
        assert any(np.any(each != 0) for each in grad) == (sign > 0)


def test_the_linear_part_is_that_of_least_squares():
    given = motions(seed=5)
    now, way, w, after = given.steps()
    u = np.concatenate([now, way, w], axis=1)
    own = dense(given)
    best = np.linalg.lstsq(np.concatenate([u, np.ones((len(u), 1))], axis=1), after, rcond=None)[0]
    np.testing.assert_allclose(np.concatenate([own.matrix, own.offset[None]]), best, atol=1e-6)  # a ridge of 1e-8


def test_windows_hold_good_frames_only():
    own = motions(episodes=2, frames=20)
    own.good[0, 11] = own.good[1, 3] = False
    starts, length = own.starts(6)
    assert length == 6
    inside = np.zeros(own.good.shape, bool)
    inside[0, :4] = inside[0, 12:15] = inside[1, 4:15] = True  # first frames of eight good ones
    np.testing.assert_array_equal(starts, np.argwhere(inside))
    starts, length = own.starts(40)  # the longest that there are, from frame 4 to 21 of the second motion
    assert (starts.tolist(), length) == ([[1, 4]], 16)


def test_what_is_played_is_what_was_trained():
    given = lesson()
    training, size = prepared(given, OWN, 0)
    network = finished(training, size, given)
    room, own = Room(network), training.motions
    z = np.asarray(played(training.own, own.z[:2], own.w[:2])) * size
    for e in range(2):
        q = np.zeros((len(z[e]) - 1, R), np.float32)
        q[0] = z[e, 1]
        room.roll(q, z[e, 0].astype(np.float32), np.ascontiguousarray(own.w[e], np.float32))
        # single precision in 60 steps that forget: 6e-8 of each of some 30 numbers a step
        np.testing.assert_allclose(q, z[e, 1:], atol=2e-5 * size)


def test_training_improves_on_the_linear_part_and_goes_on_where_it_was_interrupted():
    recipe = dataclasses.replace(OWN, hidden=(8.0, 8.0), windows=(2, 24), rate=1e-2)
    (whole, _), (part, _), (rest, _) = (prepared(lesson(), recipe, 4) for _ in range(3))
    before, seen = whole.error(), []
    assert whole.run(Budget(rounds=300), seen.append)
    assert all(a.rounds <= b.rounds for a, b in pairwise(seen))
    assert whole.state.best_error < 0.7 * before

    def stop(progress):
        stops.append(progress.rounds >= 150)
        if sum(stops) == 1 and stops[-1]:
            raise KeyboardInterrupt

    stops = []
    assert not part.run(Budget(rounds=300), stop)
    restore(rest.state, archived(part.state), numbers(part.state))
    assert rest.run(Budget(rounds=300), lambda progress: None)
    for a, b in zip(whole.state.values, rest.state.values, strict=True):
        np.testing.assert_array_equal(a, b)
    assert rest.state.best_error == whole.state.best_error


def test_the_error_of_motions_that_part_is_that_of_windows_behind_1():
    training, _ = prepared(lesson(), OWN, 0)
    given = training.held_out
    assert training.error() == training.missed(given.z, given.w, given.good) < 1.0
    training.own.linear *= 1.2  # free motions grow by more than that in each step
    assert training.missed(given.z, given.w, given.good) > 1.0
    length = OWN.windows[1]
    z, w = given.z[:, : length + 2], given.w[:, :length]  # of motions of 60 frames there is one window of 48 each
    made = np.asarray(played(training.own, z, w), float)
    missed = ((made - z)[:, 1:] ** 2).sum() / ((z - z[:, 1:2])[:, 1:] ** 2).sum()
    assert training.error() == pytest.approx(1.0 + np.sqrt(missed), rel=1e-5)  # single precision


def test_the_noise_is_that_of_windows_not_of_a_fall_at_the_end():
    given = lesson(episodes=9, frames=160)
    fallen = dataclasses.replace(given.motions, z=given.motions.z.copy())
    fallen.z[:, -20:] += 1e4 * np.arange(20)[:, None]
    plain, after = (prepared(dataclasses.replace(given, motions=each), OWN, 0) for each in (given.motions, fallen))
    assert after[1] > 100 * plain[1]  # the size of the coordinates
    np.testing.assert_allclose(after[0].noise * after[1], plain[0].noise * plain[1], rtol=0.5)  # of the median


def test_the_descent_is_that_of_the_paper():
    rng = np.random.default_rng(0)
    value = [np.zeros(3)]
    own, x, m, v = Descent(value), np.zeros(3), 0.0, 0.0
    for t in range(1, 30):
        g = rng.standard_normal(3) / t
        own.step(value, [g], 0.01)
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g
        x = x - 0.01 * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    np.testing.assert_allclose(value[0], x, rtol=1e-12)


def test_a_training_is_over_after_its_minutes_or_so_many_rounds():
    assert Budget(minutes=2.0, most=400).done(60.0, 100) == 0.5
    assert Budget(minutes=2.0, most=400).done(60.0, 300) == 0.75
    assert Budget(rounds=500, most=400).done(60.0, 300) == 0.6  # which is asked for
