"""What a prompt shows of the records: one short line of sizes and units, never arrays."""

import numpy as np
import pytest
from helpers.scenes import even

import clothfit
from clothfit.evaluation.evaluate import Distance, Evaluation
from clothfit.fit.result import Fit

LONGEST = 160
"""Characters of a line that a window shows without scrolling, or nearly."""


@pytest.fixture
def scene():
    return clothfit.load(even("GL", 6, 3, 3))


def test_a_scene_shows_its_sizes_its_step_and_what_it_fits(scene):
    springs = len(scene.cloths[0].springs)
    assert repr(scene) == (
        f"<Scene scene: 1 object, 9 vertices, {springs} springs, 6 frames of 0.02 s, implicit, "
        f"{1 + springs} values to fit>"
    )
    assert repr(scene.cloths[0]).startswith(f"<Cloth: 9 vertices, {springs} springs, 8 triangles, 0.18 kg")


def test_a_motion_shows_its_frames_and_how_much_of_it_was_observed(scene):
    positions = np.zeros((6, 9, 3))
    assert repr(clothfit.as_motion(scene, positions)) == "<Motion motion: 6 frames of 9 vertices in m, 0 … 0.1 s>"
    observed = np.zeros((6, 9), bool)
    observed[:, :3] = True
    capture = clothfit.as_motion(scene, positions, observed=observed)
    assert "0.333 of them observed" in repr(capture)


def test_a_fit_and_an_evaluation_show_their_errors(scene):
    fit = Fit(scene, "converged", "auto", 1.0, 0.0123, 6, 4, 0.5, [], [])
    assert repr(fit) == "<Fit of scene: converged, RMSE 12.3 mm over 6 frames, 0 values, 4 evaluations in 0.5 s>"
    assert "diverged, cost inf" in repr(Fit(scene, "diverged", "auto", np.inf, np.inf, 6, 4, 0.5, [], []))
    evaluation = Evaluation(Distance(6, 1e-9, 1e-8), Distance(500, 2e-3, 1.0), [])
    assert repr(evaluation) == "<Evaluation: RMSE 1 nm over 6 frames, 2 mm over 500 frames>"


def test_each_is_one_line_without_arrays(scene):
    mesh = clothfit.mesh.plane(60, 1.0, 0.5)
    shown = [repr(each) for each in (scene, scene.cloths[0], mesh, clothfit.as_motion(scene, np.zeros((6, 9, 3))))]
    assert shown[2] == f"<Mesh: {len(mesh.positions)} vertices, {len(mesh.triangles)} triangles, 1 × 0 × 0.5 m>"
    assert [text for text in shown if "\n" in text or "[" in text or len(text) > LONGEST] == []
