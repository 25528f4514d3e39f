"""Speed against error: the table's marks, the recommendation, what is known and what is not, the known surprise."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.paths import SIDE
from helpers.physics import scene, thing
from helpers.scenes import cloth, document

import clothfit
from clothfit.base.errors import InvalidInput
from clothfit.evaluation import work_precision as precision
from clothfit.evaluation.reference import Reference, converged
from clothfit.evaluation.work_precision import (
    Setting,
    Trial,
    WorkPrecision,
    front,
    grid,
    judge,
    known_frames,
    own,
    table,
    work_precision,
)
from clothfit.motion.divergence import Diverged

pytestmark = pytest.mark.slow  # compiles a fit

ONE = clothfit.load(document(cloth(), cloth(3, 2), optimizationIterations=11, forwardSubSteps=3))


@pytest.fixture(scope="module")
def found():
    """Two cloths over 11 frames."""
    return work_precision(ONE, seconds=3.0)


def reference(errors):
    """A reference with errors (F,), of one vertex that goes 1 m a frame."""
    positions = np.zeros((len(errors), 1, 3))
    positions[:, 0, 0] = np.arange(len(errors))
    return Reference(positions, np.array(errors, float), 0.01, None)


def done(squares, seconds=1.0, ratio=1.0, name="symplectic"):
    """A trial with squared distances (F,)."""
    squares = np.array(squares, float)
    steps = round((len(squares) - 1) / ratio)
    return Trial(Setting(name, ratio, None, None), steps, "done", [seconds], squares, np.sqrt(squares))


# --- a whole table


def test_every_setting_has_its_row(found):
    assert [row.setting for row in found.rows] == grid(ONE)
    assert [row.own for row in found.rows].count(True) == 1
    assert found.own.setting == Setting("implicit", 1.0, 1e-5, 3)
    assert (found.scene, found.delta, found.frames) == (ONE.name, 0.02, 11)
    assert len(found.reference.positions) == 11


def test_numbers_are_there_where_a_row_is_done_and_fit_together(found):
    rows = [row for row in found.rows if row.status == "done"]
    assert len(rows) > 40
    assert all(0 < row.error <= row.max_error for row in rows)
    assert all(row.step == row.setting.ratio * 0.02 and row.runs >= 1 for row in rows)
    costs = [row.seconds_per_second * row.step * 1e3 for row in rows]
    assert costs == pytest.approx([row.ms_per_step for row in rows])
    rest = [row for row in found.rows if row.status != "done"]
    assert {(row.error, row.ms_per_step, row.runs, row.pareto) for row in rest} <= {(None, None, 0, False)}


def test_the_error_of_the_own_row_is_the_distance_of_the_scenes_motion(found):
    gap = clothfit.simulate(ONE).positions - found.reference.positions
    assert found.own.error == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-12)  # rounding
    assert found.own.max_error == pytest.approx(np.sqrt((gap**2).sum(axis=2)).max(), rel=1e-12)


def test_the_pareto_best_are_those_that_no_other_beats(found):
    points = [row.cost_and_error for row in found.rows]
    beaten = [any(c <= cost and e <= error and (c, e) != (cost, error) for c, e in points) for cost, error in points]
    assert [row.pareto for row in found.rows] == [
        not worse and row.status == "done" for worse, row in zip(beaten, found.rows, strict=True)
    ]


def test_the_recommended_is_the_cheapest_that_is_near_enough(found):
    errors = sorted(row.error for row in found.rows if row.pareto)
    for wanted in (1.5 * errors[0], 1.5 * errors[len(errors) // 2]):
        row = found.recommended(wanted)
        assert row.pareto
        assert row.error + found.reference.error <= wanted
        cheaper = [r for r in found.rows if r.cost_and_error[0] < row.seconds_per_second]
        assert all(r.cost_and_error[1] + found.reference.error > wanted for r in cheaper)
    assert found.recommended(0.5 * errors[0]) is None
    assert found.nearest.error == errors[0]


@pytest.mark.parametrize("error", [0.0, -1.0, np.nan, np.inf])
def test_an_error_that_cannot_be_is_refused(found, error):
    with pytest.raises(InvalidInput, match="must be above 0 and finite"):
        found.recommended(error)


def test_the_references_own_error_counts():
    squares = np.full(3, 1e-4)
    found = table(scene(thing([(0, 0, 0)])), [done(squares)], reference([0, 1e-3, 1e-3]))
    (row,) = found.rows
    assert row.error == pytest.approx(0.01)
    assert found.reference.error == pytest.approx(np.sqrt(2 / 3) * 1e-3)
    assert found.recommended(0.0105) is None
    assert found.recommended(0.011) is row


def test_vertices_that_cannot_move_are_known_exactly():
    held = clothfit.load(document(cloth(vertIsFixed=[True] * 12), optimizationIterations=5))
    found = work_precision(held, seconds=1.0)
    rows = [row for row in found.rows if row.status == "done"]
    assert {(row.error, row.max_error) for row in rows} == {(0.0, 0.0)}
    (best,) = (row for row in rows if row.pareto)
    assert found.recommended(1e-9) is best is min(rows, key=lambda row: row.seconds_per_second)


def test_explicit_scenes_have_an_explicit_own():
    explicit = clothfit.load(document(cloth(), optimizationIterations=5, integrationMethod=0, delta=0.001))
    row = work_precision(explicit, seconds=1.0).own
    assert (row.setting, row.status) == (Setting("explicit", 1.0, None, None), "done")


def test_little_time_leaves_out_all_but_the_own():
    found = work_precision(ONE, 6, seconds=1e-9)
    assert found.own.status == "done"
    assert [row.status for row in found.rows].count("skipped") == len(found.rows) - 1


def test_runs_that_would_take_too_much_memory_are_left_out(monkeypatch):
    monkeypatch.setattr(precision, "MOST_STATE_BYTES", 24 * 3 * 41 * 12)  # 40 steps of one velocity, 10 of four
    found = work_precision(ONE, seconds=1.0)
    kept = {row.setting.ratio for row in found.rows if row.status != "skipped" and row.setting.integrator != "implicit"}
    assert min(kept) == 1 / 4


def test_progress_is_told():
    told = []
    work_precision(ONE, 4, 1.0, lambda seconds, what: told.append((seconds, what)))
    seconds = [when for when, _ in told]
    assert seconds == sorted(seconds)
    assert told[0][1] == "reference motion"
    assert f"setting 1 of {len(grid(ONE))}" in [what for _, what in told]


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.nan, np.inf])
def test_a_time_that_cannot_be_is_refused(seconds):
    with pytest.raises(InvalidInput, match="must be above 0 and finite"):
        work_precision(ONE, seconds=seconds)


def test_too_few_frames_and_no_reference_are_errors(monkeypatch):
    with pytest.raises(InvalidInput, match="frames must be at least 2 to compare"):
        work_precision(ONE, 1)
    monkeypatch.setattr(precision, "REFERENCE_SECONDS", 0.0)
    with pytest.raises(Diverged, match="allow more time"):
        work_precision(ONE, seconds=1e-9)


# --- its parts


def test_the_front_of_known_points():
    points = [(3.0, 1.0), (1.0, 5.0), (2.0, 5.0), (2.0, 2.0), (4.0, 1.0), (np.inf, np.inf), (2.0, 2.0)]
    assert front(points).tolist() == [True, True, False, True, False, False, False]
    assert front([]).tolist() == []


def test_frames_count_as_long_as_the_reference_is_known_there():
    # errors of 1 m so far at the reference's 10 cm, then 1 m of its own: √(1/4) of it over four frames is above 1/5
    trials = [done([0, 1, 1, 1, 1]), done([0, 4, 4, 4, 4], name="explicit")]
    assert known_frames(trials, reference([0, 0.1, 0.1, 0.1, 0.1])) == 5
    assert known_frames(trials, reference([0, 0.1, 0.1, 1.0, 0.1])) == 3
    assert known_frames([Trial(Setting("explicit", 1.0, None, None), 4)], reference([0, 0.1, 1, 1, 1])) == 5
    with pytest.raises(InvalidInput, match="not known well enough"):
        known_frames(trials, reference([0, 0.9, 0.9, 0.9, 0.9]))


def test_what_is_not_known_is_not_judged():
    trial = done([0, 1e-4, 1e-4, 9.0, 9.0])
    found = table(scene(thing([(0, 0, 0)]), delta=0.5), [trial], reference([0, 1e-4, 1e-4, 9.0, 9.0]))
    (row,) = found.rows
    assert (found.frames, len(found.reference.positions)) == (5, 3)
    assert row.error == pytest.approx(np.sqrt(2 / 3) * 0.01)
    assert row.max_error == pytest.approx(0.01)
    assert row.ms_per_step == 250.0  # of all four steps, in 1 s
    assert row.seconds_per_second == pytest.approx(0.5)


def test_the_median_of_the_runs_counts():
    trial = replace(done([0, 1e-4]), seconds=[5.0, 1.0, 1.1])
    (row,) = table(scene(thing([(0, 0, 0)]), delta=0.5), [trial], reference([0, 0])).rows
    assert (row.runs, row.ms_per_step) == (3, 1100.0)


def test_a_motion_that_left_the_scene_diverged_though_it_is_finite():
    trials = [done([0, 0.5, 0.5]), done([0, 1e6, 1e6], name="explicit")]
    rows = table(scene(thing([(0, 0, 0)])), trials, reference([0, 0, 0])).rows
    assert [(row.status, row.error is None) for row in rows] == [("done", False), ("diverged", True)]


def test_nothing_is_recommended_where_nothing_came_through():
    nothing = [Trial(Setting("implicit", 1.0, 1e-5, 1), 2, "diverged")]
    found = table(scene(thing([(0, 0, 0)])), nothing, reference([0, 0, 0]))
    assert isinstance(found, WorkPrecision)
    assert (found.nearest, found.recommended(1.0), found.own.status) == (None, None, "diverged")


# --- the known surprise


@pytest.mark.skipif(not SIDE.is_file(), reason="the real export ../shared/scenes/side.txt is not here")
def test_on_side_symplectic_quarter_steps_are_nearer_than_the_editors():
    side = clothfit.load(SIDE)
    known = converged(side, side.frames, error=1e-5)
    trials = [Trial(s, s.steps(side.frames)) for s in (own(side), Setting("symplectic", 0.25, None, None))]
    for trial in trials:
        judge(side, trial, known.positions)
    found = table(side, trials, known)
    assert len(found.reference.positions) == side.frames
    assert found.reference.error < 1e-4
    # to the digits that are told of them: 0.164 m and 0.020 m (0.0207)
    assert [row.error for row in found.rows] == pytest.approx([0.1642, 0.0207], abs=5e-5)
