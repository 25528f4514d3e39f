"""Hints from residuals: a clock, a place and two vertices that explain them; noise gives none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.strangers import WIND, sheet, stranger, windy, with_finer_steps

import clothfit
from clothfit.fit.residual_hints import exchanged, from_air
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import at_frames
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective

pytestmark = pytest.mark.slow  # compiles a fit


def motion(noise=0.0, **fields):
    exact = simulate(sheet(20.0, **fields), tolerance=1e-10)
    return degrade(exact, noise, seed=1) if noise else exact


def late_hints(target, scene=None, **options):
    """Code and text of the hints after a fit, bounds apart."""
    found = clothfit.estimate(scene or sheet(50.0), target, intervals=False, **options)
    return {hint.code: hint.text for hint in found.hints if not hint.early and hint.code != "bounds"}


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_target_that_begins_late_is_said_to(noise):
    (hint,) = late_hints(stranger(motion(noise), offset=0.1)).items()
    assert hint[0] == "time_offset"
    assert "begins 0.1 s later would explain" in hint[1]
    assert "--fit-time" in hint[1]


def test_a_target_that_begins_early_is_said_to():
    whole = motion(frames=52)
    cut = at_frames(whole, slice(6, None))
    hints = late_hints(replace(cut, times=cut.times - 0.12))
    assert "begins 0.12 s earlier" in hints["time_offset"]


def test_a_place_that_the_first_frame_does_not_show_is_said():
    moved = stranger(motion(), move=np.array([0.0, 0.02, 0.01]))
    hints = late_hints(replace(moved, times=moved.times + 0.0, observed=unseen_start(moved)))
    assert "--fit-placement" in hints["placement"]


def unseen_start(target):
    seen = np.ones(target.positions.shape[:2], bool)
    seen[0, 2:] = False  # too few points for a hint before the fit
    seen[:, sheet(20.0).cloths[0].fixed] = False  # which would show it too
    return seen


def test_two_vertices_that_are_mistaken_all_the_time_are_named():
    target = motion(1e-3)
    mixed = target.positions.copy()
    mixed[:, [22, 33]] = mixed[:, [33, 22]]
    hints = late_hints(replace(target, positions=mixed), keep_markers=True)
    assert "vertices 22 and 33" in hints["swapped_markers"]


def test_the_model_with_noise_gives_no_hint():
    assert late_hints(motion(1e-3)) == {}


def test_finer_steps_give_no_hint_of_clock_or_place():
    fine = motion(frames=157, delta=0.005)
    every = replace(fine, times=fine.times[::4], positions=np.ascontiguousarray(fine.positions[::4]))
    assert not {"time_offset", "time_scale", "placement", "swapped_markers"} & set(late_hints(every))


@pytest.mark.parametrize(("drag", "said"), [("G", False), ("n", True)])
def test_a_wind_that_single_frames_show_otherwise_is_said(drag, said):
    motion = with_finer_steps(windy(), 4)

    def hints(wind):
        scene = windy(wind)
        scene = replace(scene, cloths=(replace(scene.cloths[0], fits={"damping": "G", "drag": drag}),))
        return from_air(SimpleNamespace(scene=scene, windows=None), Objective(scene, motion, 1e-10), set())

    (hint,) = hints((-1.0, 3.0, 2.0))
    assert hint.code == "wind"
    assert "(-1, 3, 2) m/s with drag 2e+03 brings" in hint.text
    assert ("fit the drag as well" in hint.text) is said
    assert "; --windows 3 fits" in hint.text
    assert not hints(WIND)
    calm = replace(windy(), fits={})
    assert not from_air(SimpleNamespace(scene=calm, windows=None), Objective(calm, motion, 1e-10), set())


def test_exchanged_finds_the_pair_and_nothing_where_there_is_none():
    squares = np.full((4, 4), 4.0)
    assert exchanged(squares) is None
    squares[1, 3] = squares[3, 1] = 0.1
    assert exchanged(squares) == (1, 3)
