"""Hints after a fit: a clock, a place and two vertices that explain residuals; what is advised where it has stalled."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.strangers import sheet, small, stranger, windy, with_finer_steps

from clothfit import Fit, degrade, simulate
from clothfit.fit import residual_hints
from clothfit.fit.residual_hints import SHIFT, around, way_out, with_own_motion, with_stall_hint
from clothfit.motion.motion import at_frames
from clothfit.optimise.along_target import SingleSteps
from clothfit.optimise.status import Status
from clothfit.scene.fit_vector import bounds, parameters

pytestmark = pytest.mark.slow  # compiles a fit


@cache
def motion(noise=0.0, **fields):
    exact = simulate(sheet(20.0, **fields), tolerance=1e-10)
    return degrade(exact, noise, seed=1) if noise else exact


def late_hints(target, **options):
    """Code and text of the hints after a fit, bounds apart."""
    found = estimate(sheet(50.0), target, intervals=False, **options)
    return {hint.code: hint.text for hint in found.hints if not hint.before_fit and hint.code != "bounds"}


def early():
    """A target that begins early."""
    cut = at_frames(motion(frames=52), slice(6, None))
    return replace(cut, times=cut.times - 0.12)


@pytest.mark.parametrize(
    ("target", "said"),
    [
        (lambda: stranger(motion(), offset=0.1), "begins 0.1 s later would explain"),
        (lambda: stranger(motion(1e-3), offset=0.1), "begins 0.1 s later would explain"),
        (early, "begins 0.12 s earlier"),
    ],
)
def test_a_target_that_begins_late_or_early_is_said_to(target, said):
    hints = late_hints(target())
    assert list(hints) == ["time_offset"] or "earlier" in said
    assert said in hints["time_offset"]
    assert "--fit-time" in hints["time_offset"]


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_a_frame_rate_that_is_mistaken_for_its_half_or_double_is_named(rate, monkeypatch):
    """In wind no fall shows it, and from the rate 1 no step leads there."""
    monkeypatch.setattr(residual_hints, "LONGEST", 120.0)  # s: whatever else the machine does
    scene = windy(frames=60, delta=0.02, fit={})
    target = stranger(simulate(windy(frames=60, delta=0.02, stiffness=12.0)), rate)
    found = estimate(scene, target, intervals=False)
    (text,) = (hint.text for hint in found.hints if hint.code == "time_scale")
    said = float(text.split("a clock with the rate ")[1].split()[0])
    assert said == pytest.approx(rate, rel=0.05)  # a few steps of the search
    assert "--fit-time, or say the frame rate (--fps)" in text
    assert found.verdict.differs
    again = estimate(scene, target, intervals=False, fit_time=True)
    assert again.registration[0].rate == pytest.approx(rate, rel=1e-3)
    assert again.rmse < 1e-6 < 0.1 * found.rmse  # m: nothing else is wrong


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_a_clock_beside_gravity_that_is_fitted_is_named(rate):
    """All forces of a motion twice as fast are four times as large, those of the air apart."""
    target = stranger(simulate(windy(frames=60, delta=0.02, stiffness=12.0)), rate)
    found = estimate(windy(frames=60, delta=0.02, fit={"gravity": "G"}), target, intervals=False)
    (text,) = (hint.text for hint in found.hints if hint.code == "time_scale")
    assert float(text.split("a clock with the rate ")[1].split()[0]) == pytest.approx(rate, rel=0.05)  # two digits


def test_the_mirror_image_of_a_sheet_is_named_though_the_first_frame_does_not_show_it(monkeypatch):
    monkeypatch.setattr(residual_hints, "LONGEST", 120.0)  # s: whatever else the machine does
    target = motion()
    mirrored = replace(target, positions=target.positions * [1.0, -1.0, 1.0])
    np.testing.assert_array_equal(mirrored.positions[0], target.positions[0])
    hints = late_hints(mirrored)
    assert "the target seen in a mirror would explain 100 %" in hints["handedness"]
    assert "handedness" not in late_hints(stranger(target, offset=0.1))


def test_a_place_that_the_first_frame_does_not_show_is_said():
    moved = stranger(motion(), move=np.array([0.0, 0.02, 0.01]))
    seen = np.ones(moved.positions.shape[:2], bool)
    seen[0, 2:] = False  # too few points for a hint before the fit
    seen[:, sheet(20.0).cloths[0].fixed] = False  # which would show it too
    assert "--fit-placement" in late_hints(replace(moved, observed=seen))["placement"]


def test_two_vertices_that_are_mistaken_all_the_time_are_named():
    target = motion(1e-3)
    mixed = target.positions.copy()
    mixed[:, [22, 33]] = mixed[:, [33, 22]]
    hints = late_hints(replace(target, positions=mixed), keep_markers=True)
    assert "vertices 22 and 33" in hints["swapped_markers"]


def test_the_model_with_noise_gives_no_hint_and_finer_steps_none_of_clock_or_place():
    assert late_hints(motion(1e-3)) == {}
    said = late_hints(with_finer_steps(sheet(20.0), 4))
    assert not {"time_offset", "time_scale", "placement", "swapped_markers"} & set(said)


# --- targets that are motions of the model


def missing(misses_own):
    """A search whose target is a motion of its model, or may be another's."""
    return SimpleNamespace(misses_own=misses_own)


def test_what_is_left_of_a_motion_of_the_model_itself_is_said():
    each = SingleSteps(98, 1e-13, 2e-13)
    for single, rmse, own, code in (
        (each, 1e-4, False, ["chaotic"]),
        (each, 1e-10, False, []),  # single errors add up to that: 98² of them
        (None, 2e-2, True, ["own_motion"]),
        (None, 2e-2, False, []),
    ):
        found = with_own_motion(replace(fit(rmse=rmse), single_steps=single, hints=[]), missing(own))
        assert [hint.code for hint in found.hints] == code
    stopped = replace(fit(Status.LIMIT, 2e-2), hints=[])
    assert not with_own_motion(stopped, missing(True)).hints  # the time was up: that says enough


# --- searches that have stalled


def fit(status=Status.STALLED, rmse=1e-3):
    """A fit of a factor and gravity."""
    scene = small("nF", fit={"gravity": "G"})
    return Fit(
        scene=scene, cost=rmse**2, rmse=rmse, status=status, evaluations=1, seconds=0.0, method="auto", frames=24,
        parameters=[], warnings=[],
    )  # fmt: skip


def objective(error, found):
    """One whose error is a function of the parameters."""
    scene = found.scene
    return SimpleNamespace(
        scene=scene, blocks=scene.blocks, identifiable=np.array([True, True, True, False]),
        cost_or_infinity=lambda p: error(p) ** 2, rmse=np.sqrt,
    )  # fmt: skip


def advice(error, **kind):
    found = fit(**kind)
    return [(hint.code, hint.text) for hint in with_stall_hint(found, objective(error, found)).hints]


def test_a_fit_that_chose_what_to_fit_is_not_told_to():
    scene = sheet(20.0)
    assert "(--fit auto)" in way_out(scene, False)
    assert "(--fit auto)" not in way_out(scene, True)
    assert "what it touches" in way_out(scene, True)


def test_only_a_stalled_fit_that_is_off_is_advised():
    assert advice(lambda p: 2e-3, status=Status.CONVERGED) == []
    assert advice(lambda p: 2e-3, status=Status.LIMIT) == []
    assert advice(lambda p: 2e-3, rmse=0.0) == []


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (lambda p: 1e-3 * (1.0 + (p[0] - 1.0)), "fit its result in place of the scene"),
        (lambda p: 1e-3 + 5e-4 * (p[0] > 1.0), "change it by 50 %"),
        (lambda p: 1e-3 if p[0] > 1.0 else np.inf, "let it diverge"),
    ],
)
def test_the_advice_is_another_one_where_the_error_jumps(error, words):
    ((code, text),) = advice(error)
    assert code == "stalled"
    assert words in text
    assert ("jumps" in text) is ("in place of" not in text)


def test_values_around_are_a_millionth_off_within_their_bounds_and_only_those_that_are_fitted():
    found = fit()
    p = parameters(found.scene)
    lower, upper = bounds(found.scene)
    for sign, q in zip((1.0, -1.0), around(found, objective(lambda p: 1.0, found)), strict=True):
        change = sign * (q - p)
        np.testing.assert_allclose(change[[0, 2]], SHIFT * np.array([1.0, 9.81]), rtol=1e-6)
        assert change[3] == 0.0
        assert ((q >= lower) & (q <= upper)).all()
