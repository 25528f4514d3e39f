"""The wide search: its coordinates, and that it comes nearer where a gradient leads nowhere."""

import json
import random
import time
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import even, load_text

from clothfit.base import interrupts
from clothfit.fit.estimate import estimate, record_target
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters
from clothfit.strategy import ladder, wide_search
from clothfit.strategy.wide_search import Wide, widely

WIND, FRAMES = {"x": 12.0, "y": 3.0, "z": 4.0}, 24


@pytest.fixture(scope="module")
def windy():
    """The objective of a sheet in wind whose stiffness, damping, drag and wind are fitted, and its truth."""
    text = even("nG", FRAMES, windVel=WIND, fit={"windVel": True})
    text["objects"][0] |= {"fit": {"damping": "G", "dragCoefficient": "G"}, "damping": 0.3, "dragCoefficient": 0.4}
    scene = load_text(json.dumps(text))
    return Objective(scene, record_target(scene), 1e-10), parameters(scene)


def searched(objective, p):
    search = Search(objective, p, -1.0, 1000)  # which never ends by itself
    search.visit(p)
    return search


def blocks(objective):
    return {block.name: block.part for block in objective.blocks}


def test_coordinates_and_parameters_are_each_others_inverse(windy):
    objective, truth = windy
    wide = Wide(searched(objective, truth))
    x = wide.x(truth) + 0.3
    np.testing.assert_allclose(wide.x(wide.parameters(x)), x, rtol=1e-12)
    np.testing.assert_allclose(wide.parameters(wide.x(truth)), truth, rtol=1e-12)


def test_another_drag_keeps_the_push_of_the_wind(windy):
    objective, truth = windy
    own, part = Wide(searched(objective, truth)), blocks(objective)
    x = own.x(truth)
    x[part["drag"]] += np.log(5.0)
    p = own.parameters(x)
    np.testing.assert_allclose(p[part["drag"]], 5.0 * truth[part["drag"]], rtol=1e-12)
    np.testing.assert_allclose(p[part["wind"]], truth[part["wind"]] / 5.0, rtol=1e-12)
    others = np.setdiff1d(np.arange(len(p)), [*range(part["wind"].start, part["wind"].stop), part["drag"].start])
    np.testing.assert_allclose(p[others], truth[others], rtol=1e-12)


def test_a_damping_of_nothing_has_a_place_beside_others(windy):
    objective, truth = windy
    part, p = blocks(objective), truth.copy()
    p[part["damping"]] = 0.0
    wide = Wide(searched(objective, p))
    assert np.isfinite(wide.x(p)).all()
    assert wide.parameters(wide.x(p))[part["damping"]] < 1e-5  # FLOOR of what is typical


def test_in_a_known_wind_values_are_drawn_far_off_and_the_wind_stays():
    text = even("nG", FRAMES, windVel=WIND)
    text["objects"][0] |= {"fit": {"dragCoefficient": "G"}, "dragCoefficient": 0.4}
    scene = load_text(json.dumps(text))
    wide = Wide(searched(Objective(scene, record_target(scene), 1e-10), parameters(scene)))
    x = wide.x(wide.p)
    points = wide.far(x, np.random.default_rng(0))
    assert points[0].tolist() == x.tolist()
    assert (np.std(points[1:], axis=0) > wide.widths).all()  # 1.5 of them, of 200
    assert len(wide.blows) == 0
    assert wide.around(x).tolist() == wide.widths.tolist()


def test_it_comes_nearer_from_far_off_and_never_ends_farther(windy, monkeypatch):
    objective, truth = windy
    monkeypatch.setattr(wide_search, "WORK", wide_search.WORK // 100)
    part, p = blocks(objective), truth.copy()
    p[part["stiffness"]] *= 8.0
    p[part["wind"]] = [1.0, -4.0, -9.0]  # from the other side
    search = searched(objective, p)
    before = search.best.cost
    widely(search)
    # its 600 points lead to an error of 1e-5 of this one, half as many to 8 %
    assert search.best.cost < 1e-3**2 * before
    assert search.best.cost == objective.cost(search.best.p)


def test_it_ends_at_the_same_point_with_one_thread_and_with_two(windy, monkeypatch):
    objective, truth = windy
    monkeypatch.setattr(wide_search, "WORK", wide_search.WORK // 400)
    found = []
    for count in (1, 2):
        monkeypatch.setattr(wide_search, "threads", lambda count=count: count)
        search = searched(objective, 3.0 * truth)
        widely(search)
        found.append((search.best.p.tolist(), search.budget.evaluations))
    assert found[0] == found[1]


def test_a_fit_in_wind_does_not_depend_on_how_fast_the_machine_is(windy, monkeypatch):
    objective, truth = windy
    target = objective.experiments[0].motion
    far = replace(target, positions=target.positions + 0.05 * np.sin(40.0 * np.arange(FRAMES))[:, None, None])
    monkeypatch.setattr(wide_search, "WORK", wide_search.WORK // 400)
    widely_searched, found, start = [], [], 3.0 * truth
    start[blocks(objective)["wind"]] = 0.0
    monkeypatch.setattr(ladder, "widely", lambda own, **work: widely_searched.append(own) or widely(own, **work))
    for seed in range(2):
        clock, draw = time.process_time, random.Random(seed)
        monkeypatch.setattr(time, "process_time", lambda clock=clock, draw=draw: clock() * 20.0 * draw.random())
        fit = estimate(objective.scene, far, start=start, intervals=False)
        monkeypatch.setattr(time, "process_time", clock)
        found.append((parameters(fit.scene).tolist(), fit.evaluations))
    assert len(widely_searched) == 2
    assert found[0] == found[1]


def test_a_deadline_ends_it_in_both_threads(windy):
    objective, truth = windy
    search = searched(objective, truth)
    with pytest.raises(interrupts.OutOfTime), interrupts.limited(0.0):
        widely(search)


def test_a_budget_of_evaluations_ends_it(windy):
    objective, truth = windy
    search = Search(objective, 3.0 * truth, -1.0, 200)
    search.visit(search.start)
    widely(search)
    # the scan of 200 points is not cut; what comes after it keeps 100 evaluations
    assert 50 < len(search.budget.history) <= 110
