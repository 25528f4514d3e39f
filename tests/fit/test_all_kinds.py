"""Fits of every kind find the values that made the target, under known forces and on colliders too; starts, bounds, and
what is told.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.physics import ball, xyz
from helpers.scenes import cloth, document, write_scene

from clothfit import Forces, new_scene, parameters, simulate, with_parameters
from clothfit.cli.program import run
from clothfit.fit.estimate import record_target
from clothfit.fit.start import neutral
from clothfit.meshes.mesh import plane
from clothfit.objective.identifiability import identifiable
from clothfit.scene.scene import dumps, load

pytestmark = pytest.mark.slow

LENGTHS = load(document(cloth(3, 3))).cloths[0].lengths
RNG = np.random.default_rng(31)
WIND = {"windVel": xyz((3, 1, -2))}

PATH = [xyz((0, 0, 0)), xyz((0.25, 0.1, 0.15))]  # by (0.3, 0.1, 0.2) L-BFGS-B stops where other contacts begin
MOVES = {"posKeys": {"times": [0, 1], "values": PATH}}
RUBS = {**ball((1.0, -0.75, 1.0), 0.8), "friction": 0.4, "stiffness": 900.0, **MOVES}
TOUCHED = {"colliders": [RUBS, ball((2.0, -0.75, 2.0), 0.8)], "colliderOffset": xyz((0.01, 0.005, -0.01))}

# Fields of the one object, fields of the scene.
CASES = {
    "velocity": ({"fit": {"vertVel": "G"}, "vertVel": [xyz((1, 0.5, -2))] * 9}, {}),
    "velocities": ({"fit": {"vertVel": "L"}, "vertVel": [xyz(v) for v in RNG.normal(size=(9, 3))]}, {}),
    "rest factor": ({"fit": {"springRestLength": "G"}, "springRestLength": (0.9 * LENGTHS).tolist()}, {}),
    "rest lengths": ({"fit": {"springRestLength": "L"}, "springRestLength": RNG.uniform(0.7, 1.2, 16).tolist()}, {}),
    "wind": ({"dragCoefficient": 0.4}, {"fit": {"windVel": True}, **WIND}),
    "friction, contact stiffness and offset": (
        {}, {"fit": {"colliderOffset": True, "friction": "G", "contact": "L"}, **TOUCHED},
    ),
    "gravity": ({}, {"fit": {"gravity": True}, "gravity": xyz((1, -7, 2))}),
    "drag and damping and wind": (
        {"fit": {"damping": "G", "dragCoefficient": "G"}, "damping": 0.6, "dragCoefficient": 0.4},
        {"fit": {"windVel": True}, **WIND},
    ),
    "drag and damping and wind in the law air": (
        {"fit": {"damping": "G", "dragCoefficient": "G"}, "damping": 0.6, "dragCoefficient": 1.4, "dragLaw": "air"},
        {"fit": {"windVel": True}, **WIND},
    ),
    "stiffness, drag and damping": (
        {"fit": {"damping": "G", "dragCoefficient": "G"}, "damping": 0.6, "dragCoefficient": 0.4}
        | {"optimizationSettings": "nG", "springStiffness": [30.0] * 16},
        WIND,
    ),
    "masses and drag": (
        {"fit": {"dragCoefficient": "G"}, "dragCoefficient": 0.4, "optimizationSettings": "Gn", "vertMass": [0.02] * 9},
        {},
    ),
}


def made(case, frames=20, **more):
    """The scene of a case."""
    own, whole = CASES[case]
    return load(document(cloth(3, 3, **{**own, **more}), optimizationIterations=frames, **whole))


@pytest.mark.parametrize("method", ["auto", "l-bfgs-b"])
@pytest.mark.parametrize("case", CASES)
def test_a_fit_finds_what_is_hidden_from_it(case, method):
    scene = made(case)
    found = estimate(scene, method=method)
    kept = identifiable(scene)
    assert found.status == "converged"
    assert found.rmse < 1e-8
    # 1e-8 m in the positions; the velocity at the start of each vertex is soon damped, so it shows least
    np.testing.assert_allclose(parameters(found.scene)[kept], parameters(scene)[kept], atol=1e-3)


def test_a_hidden_truth_starts_from_values_that_do_not_depend_on_it():
    scene = made("drag and damping and wind")
    scenes = [with_parameters(scene, factor * parameters(scene)) for factor in (1, 3)]
    starts = [parameters(estimate(each, max_evaluations=1).scene) for each in scenes]
    np.testing.assert_array_equal(*starts)
    np.testing.assert_allclose(starts[0], neutral(scene), rtol=1e-14)  # there and back through the coordinates
    assert neutral(scene).tolist() == [0.1, 1.0, 0.1, 0.1, 0.1]


def test_neutral_lengths_are_those_at_the_start_of_the_motion():
    for case, expected in (("rest factor", [1.0]), ("rest lengths", LENGTHS), ("gravity", [0, -9.81, 0])):
        np.testing.assert_array_equal(neutral(made(case)), expected)


@pytest.mark.parametrize(
    ("case", "start", "shown", "expected"),
    [
        ("masses and drag", 0.5, True, [0.5, 0.4]),
        ("masses and drag", 0.5, False, [0.5, 1.0]),  # neutral, as the truth is hidden
        ("gravity", 2.0, False, [2.0, 2.0, 2.0]),
    ],
)
def test_a_number_is_a_start_of_masses_and_stiffnesses_or_of_all(case, start, shown, expected):
    scene = made(case)
    target = record_target(scene) if shown else None
    found = estimate(scene, target, start=start, method="l-bfgs-b", max_evaluations=1)
    np.testing.assert_allclose(parameters(found.scene), expected, rtol=1e-14)  # there and back through the coordinates


def test_the_command_names_the_scene_and_gives_null(tmp_path, capsys):
    own, whole = CASES["wind"]
    path = write_scene(tmp_path, document(cloth(3, 3, **own), optimizationIterations=20, **whole))
    out = str(tmp_path / "fitted.json")
    assert run(["estimate", path, "-o", out, "--json", "-v"]) == 0
    told = capsys.readouterr()
    assert "fitting scene wind (G) over 20 frames" in told.err
    (block,) = json.loads(told.out)["parameters"]
    assert (block["object"], block["name"], block["mode"], block["count"]) == (None, "wind", "G", 3)
    assert run(["evaluate", path, out, "--json"]) == 0
    (deviation,) = json.loads(capsys.readouterr().out)["parameters"]
    assert deviation["object"] is None
    assert deviation["max_relative_deviation"] < 1e-4  # an RMSE below 1e-8 m
    assert run(["evaluate", path, out]) == 0
    assert "scene wind (G)" in capsys.readouterr().out


# --- a motion that was made under known forces


@pytest.mark.parametrize("how", ["momentum", "gauss-newton"])
def test_values_come_back_from_a_motion_under_forces(how):
    one = cloth(damping=0.3, springStiffness=(20.0 + np.arange(23)).tolist(), optimizationSettings="nL")
    own = load(document(one, optimizationIterations=31, **WIND))
    values, turn = np.zeros((30, 12, 3)), np.linspace(0.0, 6.0, 30)[:, None]
    values[:, [5, 6, 11]] = 0.5 * np.stack([np.sin(turn), np.cos(turn), np.sin(2.0 * turn)], axis=2)
    known = own.with_forces(Forces(0.02 * np.arange(30), values))
    target = simulate(known, tolerance=1e-12)
    guess = known.with_values([known.cloths[0].mass], [1.3 * known.cloths[0].stiffness])
    found = estimate(guess, target, method=how)
    moved = ~own.cloths[0].fixed[own.cloths[0].springs].all(axis=1)  # the others are not seen
    truth = known.cloths[0].stiffness[moved]
    np.testing.assert_allclose(found.scene.cloths[0].stiffness[moved], truth, rtol=1e-6)  # errors of solves
    blind = estimate(guess.with_forces(None), target, method=how)
    assert blind.rmse > 1e3 * found.rmse


# --- cloths that lie, slide and fall on colliders


ROUGH = {"friction": 0.3, "thickness": 0.01}
BOX = {"type": 3, "pos": xyz((0, 0.25, 0)), "scale": xyz((0.6, 0.5, 0.6)), **ROUGH}
FLOOR = {"type": 0, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1)), **ROUGH}
STEPS = {"times": [0, 0.4, 0.8], "values": [xyz((0, 0, 0)), xyz((0.1, 0.02, 0.05)), xyz((0.2, 0, 0))]}
WALK = {"posKeys": {**STEPS, "interpolation": "smooth"}}
FIGURE = [
    {"type": 2, "pos": xyz((0, 0.1, 0)), "scale": xyz((1, 1, 1)), "radius": 0.17, "radius2": 0.2, "height": 0.5},
    {"type": 2, "pos": xyz((0, 0.4, 0)), "rot": xyz((0, 0, 90)), "scale": xyz([1] * 3), "radius": 0.08, "height": 0.5},
    ball((0, 0.5, 0), 0.1),
]


def dropped(colliders, settings, fit, frames=41, **fields):
    """A cloth of 1 m that falls onto colliders, a little off their middle."""
    mesh = plane(6, 1.0)
    turn = np.array([[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]])
    mesh = mesh._replace(positions=mesh.positions @ turn.T + [0.1, fields.pop("height", 0.53), 0.07])
    bare = json.loads(dumps(new_scene(mesh, fit=settings, integrator="implicit", frames=frames)))
    return load({**bare, "planes": "solid", "colliders": colliders, "fit": fit, **fields})


def intervals(found):
    """Of all values, in the order of the fit vector, (P, 2)."""
    return np.array([ends for block in found.parameters for ends in block.interval])


def noisy(motion, metres):
    """The motion with noise of so many metres in each coordinate of all frames but the first."""
    noise = np.random.default_rng(3).normal(0, metres, motion.positions.shape)
    noise[0] = 0
    return replace(motion, positions=motion.positions + noise)


@pytest.mark.parametrize(("settings", "off"), [("nn", 0.5), ("nF", 2.0)])
def test_the_friction_of_a_tablecloth_is_found_from_a_start_that_is_off_by_two(settings, off):
    made = dropped([BOX, FLOOR], settings, {"friction": "G"})
    exact, truth = record_target(made), parameters(made)
    start = with_parameters(made, off * truth)
    truth = parameters(made, flags=start)
    found = estimate(start, exact)
    # the positions are known to 1e-8 m, of which a change of friction by 1e-4 makes some µm
    np.testing.assert_allclose(parameters(found.scene, flags=start), truth, rtol=1e-4)
    rough = estimate(start, noisy(exact, 1e-3))
    lower, upper = intervals(rough).T
    assert np.all((lower <= truth) & (truth <= upper))  # so in 95 of 100; the seed is one of those
    assert np.all(upper - lower < 0.1 * truth)


def test_where_a_figure_walks_is_found():
    made = dropped([{**each, **WALK} for each in FIGURE], "nn", {"colliderOffset": "G"}, height=0.72)
    moved = with_parameters(made, [0.03, -0.02, 0.025])
    found = estimate(made, record_target(moved))
    np.testing.assert_allclose(found.scene.offset, moved.offset, rtol=1e-4)


def test_the_law_of_self_contact_is_found_where_a_sheet_slides_down_a_sheet():
    mesh = plane(3, 0.3)
    count = len(mesh.positions)
    below = mesh.positions - mesh.positions.mean(axis=0)
    above = below + [0.03, 0.012, 0.01]
    both = mesh._replace(
        positions=np.concatenate([below, above]), triangles=np.concatenate([mesh.triangles, mesh.triangles + count])
    )
    slope = xyz((9.81 * np.sin(0.25), -9.81 * np.cos(0.25), 0))
    held = np.arange(2 * count) < count
    bare = json.loads(dumps(new_scene(both, fixed=held, integrator="implicit", frames=25, fit="nn")))
    law = {"thickness": 0.01, "stiffness": 200.0, "friction": 0.15}
    made = load({**bare, "gravity": slope, "selfCollision": law, "fit": {"friction": "G", "contact": "G"}})
    truth = parameters(made)
    found = estimate(with_parameters(made, 0.7 * truth), record_target(made)).scene
    # the positions are known to 1e-8 m, of which a change by 1e-4 makes some µm
    np.testing.assert_allclose(parameters(found), truth, rtol=1e-4)
    assert load(json.loads(dumps(found))).self_contact == found.self_contact
