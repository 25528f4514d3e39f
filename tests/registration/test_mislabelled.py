"""Mistaken markers: exactly those that were swapped, that jump or that show no vertex, and none of a good target."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.strangers import sheet, stranger, windy

from clothfit.motion.degrade import degrade
from clothfit.motion.markers import rigid
from clothfit.motion.simulate import simulate
from clothfit.registration import mislabelled as mistaken_module
from clothfit.registration.mislabelled import alone, disorder, mislabelled
from clothfit.registration.record import Jump, Markers, Swap, rotation

pytestmark = pytest.mark.slow  # compiles a simulation

NOISE = 1e-3
R, D = rotation(np.array([0.1, 0.3, -0.2])), np.array([0.3, -0.2, 0.1])


def test_a_target_that_lies_where_it_starts_is_brought_there_at_once(monkeypatch):
    """Of places that agree to rounding other ones are the nearest half each time."""
    calls, rng = [], np.random.default_rng(1)
    start = rng.normal(size=(400, 3))
    monkeypatch.setattr(mistaken_module, "rigid", lambda *given: calls.append(1) or rigid(*given))
    np.testing.assert_allclose(mistaken_module.moved(start @ R.T + D, start), start, atol=1e-14)  # rounding
    assert len(calls) < 20


@cache
def exact():
    """The motion of a sheet of 0.5 m."""
    return simulate(sheet(20.0))


def capture(seed=1, observed=0.5, noise=NOISE):
    """Markers of it, and the vertices that have them."""
    motion = degrade(exact(), noise, observed=observed, seed=seed)
    return motion, np.flatnonzero(motion.seen().all(axis=0))


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_frames_in_another_order_are_named_and_those_of_motions_in_order_are_not(noise):
    for motion in (capture(noise=noise)[0], degrade(simulate(windy(frames=60)), noise)):
        assert disorder(motion) is None
        x, count = motion.positions, len(motion.times)
        order = np.random.default_rng(2).permutation(count)
        assert "in no order" in disorder(replace(motion, positions=x[order]))
        if not noise:  # what is exchanged moves less than that
            order = np.arange(count)
            order[[10, 11]] = 11, 10
            assert "frames 10 and 11 are exchanged" in disorder(replace(motion, positions=x[order]))
            order = np.arange(count)
            order[8:16] = order[8:16][::-1]
            assert "frames 8 to 15 are in reverse" in disorder(replace(motion, positions=x[order]))


def wrongly(motion, *places):
    """A motion with other positions at some places, each with its vectors, m."""
    wrong = motion.positions.copy()
    for place, values in places:
        wrong[place] = values
    return replace(motion, positions=wrong)


def given_to(motion, order):
    """A motion whose vertex `order[i]` has what `i` shows."""
    mixed = motion.positions.copy()
    mixed[:, list(order.values())] = motion.positions[:, list(order.keys())]
    return replace(motion, positions=mixed)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_good_targets_have_no_mistaken_markers(seed, noise):
    motion, _ = capture(seed, 0.4, noise)
    for each in (motion, stranger(motion, 1.1, 0.015), stranger(motion, turn=R, move=D)):
        assert not mislabelled(sheet(20.0), each, late=True)
    blown = windy(frames=60)
    assert not mislabelled(blown, degrade(simulate(blown), noise, seed=seed))


@pytest.mark.parametrize("seed", range(5))
def test_swapped_markers_are_exchanged_whatever_the_place(seed):
    motion, seen = capture(seed)
    a, b, c, d, e = (int(each) for each in np.random.default_rng(seed).permutation(seen)[:5])
    mixed = stranger(given_to(motion, {a: b, b: a, c: d, d: e, e: c}), offset=0.015, turn=R, move=D)
    found = mislabelled(sheet(20.0), mixed, late=True)
    assert {frozenset(each.vertices) for each in found.swapped} == {frozenset((a, b)), frozenset((c, d, e))}
    assert (found.false, found.jumps) == ((), ())
    whole = found.applied(mixed)
    right = stranger(motion, offset=0.015, turn=R, move=D)
    assert np.array_equal(whole.positions, right.positions, equal_nan=True)


def test_markers_that_change_places_later_are_put_right_from_there_on():
    motion, (a, b, *_) = capture(noise=0.0)
    x = motion.positions
    mixed = wrongly(motion, ((slice(7, 20), [a, b]), x[7:20, [b, a]]))
    found = mislabelled(sheet(20.0), mixed)
    assert [each.frame for each in found.swapped] == [7, 20]
    assert np.array_equal(found.applied(mixed).positions, motion.positions, equal_nan=True)


def test_a_marker_that_stands_elsewhere_and_one_that_jumps_are_left_out():
    motion, (a, b, *_) = capture()
    x, jumps = motion.positions, [5, 11, 30]
    wrong = wrongly(motion, (np.s_[:, a], x[0, a] + [0.2, 0.3, -0.4]), ((jumps, b), x[jumps, b] + [0.0, 0.2, 0.1]))
    found = mislabelled(sheet(20.0), wrong)
    assert found == Markers((), (a,), (Jump(b, (5, 11, 30)),))
    left = found.applied(wrong)
    assert not left.seen()[:, a].any()
    assert np.flatnonzero(~left.seen()[:, b]).tolist() == [5, 11, 30]


def test_a_jump_of_two_frames_is_left_out_and_one_that_stays_is_not():
    motion, (a, b, *_) = capture()
    x, two = motion.positions, [11, 12]
    jumps, stays = x[two, a] + [[0.3, 0.1, 0.0], [-0.1, 0.2, 0.3]], x[20:23, b] + [0.3, 0.1, 0.0]
    found = mislabelled(sheet(20.0), wrongly(motion, ((two, a), jumps), (np.s_[20:23, b], stays)))
    assert [each for each in found.jumps if each.vertex == a] == [Jump(a, (11, 12))]
    assert not [each for each in found.jumps if each.vertex == b]
    shiver = 0.6 * np.median(sheet(20.0).cloths[0].lengths) * np.array([1.0, -1.0])  # within the length of a spring
    assert mislabelled(sheet(20.0), wrongly(motion, ((two, a, 1), x[two, a, 1] + shiver))).jumps == ()


def test_a_chain_that_ends_in_a_false_marker_leaves_its_vertex_without_one():
    motion, (a, b, *_) = capture()
    wrong = wrongly(motion, (np.s_[:, a], motion.positions[:, b]), (np.s_[:, b], 2.0))  # a's marker shows b, b's a wall
    found = mislabelled(sheet(20.0), wrong)
    assert found.swapped == (Swap((a, b), closed=False),)
    right = found.applied(wrong)
    assert np.array_equal(right.positions[:, b], motion.positions[:, b])
    assert not right.seen()[:, a].any()


def test_another_shape_is_no_mistake():
    motion, _ = capture()
    bent = motion.positions + 0.1 * np.sin(np.arange(motion.positions.shape[1]))[None, :, None]
    assert not mislabelled(sheet(20.0), replace(motion, positions=bent)).swapped


def test_a_fit_names_and_exchanges_them_unless_it_is_told_to_keep_them():
    motion, (*_, a, b) = capture(noise=1e-4)
    mixed = given_to(motion, {a: b, b: a})
    found, plain = (estimate(sheet(50.0), each, intervals=False) for each in (mixed, motion))
    kept = estimate(sheet(50.0), mixed, intervals=False, keep_markers=True)
    assert found.rmse == plain.rmse
    assert kept.rmse > 10.0 * found.rmse
    assert (plain.markers, kept.markers) == (None, None)
    (markers,) = found.markers
    assert markers.summary(motion.vertex_counts) == {
        "swapped": [{"object": 0, "vertices": sorted([a, b]), "frame": 0}], "false": [], "jumps": [],
    }  # fmt: skip
    (hint,) = (each for each in found.hints if each.code == "swapped_markers")
    assert "exchanged" in hint.text
    assert hint.before_fit


def test_a_jump_of_a_fast_marker_is_one_and_a_whip_is_none():
    way = np.arange(5.0)[:, None, None] * np.array([1.0, 0.0, 0.0])  # as fast as it jumps
    spike, whip = way.copy(), way.copy()
    spike[2, 0, 1] = 0.8
    whip[:, 0, 1] = [0.0, 0.3, 0.8, 0.3, 0.0]  # pulled there and back over the frames around as well
    assert alone(np.concatenate([way, spike, whip], axis=1)).tolist() == [False, True, False]
