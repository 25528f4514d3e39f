"""Motions in which rounding decides: twins of a calm motion stay together, those of one that crumples do not."""

import numpy as np
from helpers.scenes import even

from clothfit import load, mesh, new_scene
from clothfit.fit.few_values import ROUNDING, steps_before_chaos, twins


def test_twins_of_a_hanging_sheet_stay_together():
    """Along a fold that gravity draws straight a difference only swings: within ten times what it began with."""
    scene = load(even("nG", 30))
    size = np.linalg.norm(np.ptp(scene.cloths[0].positions, axis=0))
    assert twins(scene, 30) < 10 * ROUNDING * size


def test_twins_of_a_sheet_that_stands_on_end_fall_apart():
    """A flat sheet held at its lower edge is an unstable balance: rounding is all that makes it bend."""
    sheet = mesh.plane(6, 0.5, upright=True)
    scene = new_scene(sheet, sheet.positions[:, 1] < -0.24, stiffness=20.0, damping=0.0)
    size = np.linalg.norm(np.ptp(sheet.positions, axis=0))
    assert twins(scene, 60) > 1e3 * ROUNDING * size


def test_nothing_that_is_reproduced_is_no_chaos():
    assert steps_before_chaos(None, []) == 0
