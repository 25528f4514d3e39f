"""Which kinds a fit needs: the error on blocks that are kept out, and what is found of a sheet that falls."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.strangers import small, with_finer_steps

from clothfit import degrade, mesh, new_scene, simulate
from clothfit.base.interrupts import OutOfTime
from clothfit.engine.system import BDF2
from clothfit.fit import routes
from clothfit.fit.frame_blocks import Choice, kept_out, needed, without
from clothfit.motion.motion import rms
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow


def test_blocks_kept_out_cost_what_fits_without_them_leave_there():
    rng, blocks, size = np.random.default_rng(2), 6, 5
    J, r = rng.normal(size=(blocks, 20, size)), rng.normal(size=(blocks, 20))
    left, back = np.array([False, True, False, False, True]), rng.normal(size=size)
    H, g = np.einsum("bri,brj->bij", J, J), np.einsum("bri,br->bi", J, r)
    change = 0.0
    for b in range(blocks):
        others = [i for i in range(blocks) if i != b]
        rest = np.concatenate([r[i] + J[i][:, left] @ back[left] for i in others])
        d = back.copy()
        d[~left] = np.linalg.lstsq(np.concatenate([J[i][:, ~left] for i in others]), -rest, rcond=None)[0]
        change += np.sum((r[b] + J[b] @ d) ** 2) - np.sum(r[b] ** 2)
    assert kept_out(H, g, left, back) == pytest.approx(change, rel=1e-9)  # the normal equations' rounding


def test_what_is_said_of_a_kind():
    for choice, text in (
        (Choice("wind", True, 0.3), "wind: fitted; without it, frames kept out would be 30 % farther away"),
        (Choice("wind", True, 457.69), "wind: fitted; without it, frames kept out would be many times as far away"),
        (Choice("wind", True, 0.0), "wind: fitted; frames kept out do not speak against it"),
        (Choice("wind", True, -0.1), "wind: fitted; without it the fit ends farther away"),
        (Choice("gravity", False, -0.1), "gravity: not fitted; with it, frames kept out would be 10 % farther away"),
    ):
        assert choice.text == text


@pytest.mark.parametrize("started", [-4.0, -9.81])
def test_gravity_is_needed_where_the_scene_has_another(started):
    scene = small("nF", 60, method=BDF2, fit={"gravity": "G", "windVel": "G"}, of_cloth={"damping": "G"})
    target = with_finer_steps(small("nF", 60, method=BDF2, springStiffness=[40.0] * 33), 8)
    search = Search(Objective(scene, target, 1e-10, scene.frames), parameters(scene), 1e-8, 100)
    search.visit(search.start)
    (block,) = (block for block in scene.blocks if block.name == "gravity")
    search.origin = search.start.copy()
    search.origin[block.part] = [0.0, started, 0.0]
    found = {choice.name: choice for choice in needed(search)[0]}
    assert set(found) == {"wind", "gravity"}
    assert (found["gravity"].needed, found["gravity"].rise > 0.1) == (started == -4.0,) * 2
    fewer = without(scene, parameters(scene), ["wind"])
    assert [each.name for each in fewer.blocks] == [each.name for each in scene.blocks if each.name != "wind"]


def stiff(stiffness):
    """A sheet so stiff that folds buckle, which falls from one side."""
    sheet = mesh.plane(6, 1.0)
    held = sheet.positions[:, 0] < -0.49
    return new_scene(sheet, held, stiffness=stiffness, bending=0.05, fit="nn", fits={"damping": "G"}, frames=50)


def test_few_kinds_explain_a_noisy_capture_that_buckles_from_a_start_that_is_far_off():
    noise = 1.5e-3
    capture = degrade(simulate(stiff(500.0)), noise, observed=0.8, fps=30, seed=1)
    found = estimate(stiff(1500.0), capture, fit="auto")
    assert [each.model for each in found.ladder] == ["F"]  # and neither maps nor wind nor gravity
    assert "nothing else is fitted" in " ".join(hint.text for hint in found.hints)
    assert found.rmse == pytest.approx(noise * np.sqrt(3), rel=0.05)  # some 4000 numbers scatter by 1 %
    # half of those frames follow the stiffness by centimetres for each factor e
    assert found.scene.cloths[0].stiffness == pytest.approx(stiff(500.0).cloths[0].stiffness, rel=0.02)


def test_a_wind_that_the_scene_does_not_have_is_one_of_few_kinds():
    windy = replace(stiff(500.0), wind=np.array([1.0, 0.0, 0.7]), cloths=in_air(stiff(500.0)))
    start = replace(stiff(1500.0), cloths=in_air(stiff(1500.0)))
    capture = degrade(simulate(windy), 1e-3, observed=0.8, fps=30, seed=2)
    found = estimate(start, capture, fit="auto")
    assert [block.name for block in found.parameters] == ["stiffness", "damping", "wind"]
    assert found.scene.wind == pytest.approx(windy.wind, abs=0.05)  # it moves the sheet by decimetres


def in_air(scene):
    """The cloths of a scene, which feel real air."""
    return tuple(replace(cloth, drag=1.2, drag_law="air") for cloth in scene.cloths)


@pytest.mark.parametrize("ended", [True, False])
def test_what_few_kinds_came_to_is_kept_where_nothing_comes_nearer(monkeypatch, ended):
    """By longer steps than those of the target, which no values make up for; the rest has no time, or does nothing."""

    def rest(fit):
        if ended:
            raise OutOfTime
        return Status.CONVERGED

    few = next(route for route in routes.CHOICES if route.name == "few kinds")
    monkeypatch.setattr(routes, "CHOICES", [few])
    monkeypatch.setattr(routes, "ROUTES", [routes.Route("rest", lambda fit: True, rest)])
    scene, truth = stiff(60.0), stiff(20.0)
    target = with_finer_steps(truth, 8)
    found = estimate(scene, target, fit="auto")
    assert found.status == ("limit" if ended else "stalled")
    # no farther than the start, whose linear systems `simulate` solves to 1e-8
    assert found.rmse <= (1.0 + 1e-4) * rms(simulate(scene).positions - target.positions)
    assert {block.name for block in found.parameters} <= {"stiffness", "damping", "wind"}
    assert not [text for text in found.warnings if "those of the start" in text]
