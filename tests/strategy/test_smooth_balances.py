"""Values from smooth balances of momentum: the rows by the forces of the engine, what they find, and the start of a
fit in wind.
"""

from dataclasses import replace

import numpy as np
import pytest
from helpers.strangers import DAMPING, DRAG, WIND, windy, with_finer_steps

from clothfit.engine.forces import total
from clothfit.engine.system import build
from clothfit.motion.motion import at_frames
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters
from clothfit.strategy import smooth_balances
from clothfit.strategy.start import with_air

NEAR = 0.2
"""Relative error of what is found: drag and damping resist alike, and differences over 2.5 ms are off by some percent
where springs swing in 60 ms.
"""


DRAGS = {"editor": DRAG, "air": 1.2}


@pytest.fixture(scope="module")
def motion():
    """The motion of such a sheet by steps four times finer."""
    return with_finer_steps(windy(), 4)


@pytest.fixture(scope="module")
def motions(motion):
    """The same, and that with the other law of the air."""
    return {"editor": motion, "air": with_finer_steps(windy(drag=DRAGS["air"], law="air"), 4)}


@pytest.mark.parametrize("law", DRAGS)
def test_the_rows_are_the_forces_of_the_engine_over_smooth_fields(motions, law):
    drag = DRAGS[law]
    scene = windy(drag=drag, law=law)
    frames = smooth_balances.frames_of(motions[law], 0, scene)
    terms = smooth_balances.Terms(scene, 0, frames)
    wanted = smooth_balances.unknowns(scene, scene.cloths[0])
    C, right = terms.rows()
    values = {"stiffness": (1.0,), "damping": (DAMPING,), "drag": (drag,), "wind": drag * np.array(WIND)}
    found = (C @ [values[name][axis] for name, axis in wanted]).reshape(len(terms.fields), -1, 3)
    system = build(scene, 0)
    for i in (0, 7, 30):
        force = np.zeros((36, 3))
        total.add_force(system, np.ascontiguousarray(frames.x[i]), np.ascontiguousarray(frames.v[i]), force)
        force -= scene.cloths[0].mass[:, None] * scene.gravity
        np.testing.assert_allclose(found[:, i], terms.fields @ force, atol=1e-12 * np.abs(force).max())
        moved = scene.cloths[0].mass[:, None] * (frames.a[i] - scene.gravity)
        right_side = right.reshape(found.shape)[:, i]
        np.testing.assert_allclose(right_side, terms.fields @ moved, atol=1e-12 * np.abs(moved).max())


def test_fields_are_smooth_and_vanish_where_the_cloth_is_held():
    own = windy().cloths[0]
    found = smooth_balances.fields(own)
    assert found.shape == (smooth_balances.FIELDS, 36)
    assert not found[:, own.fixed].any()
    assert np.linalg.matrix_rank(found) == smooth_balances.FIELDS


@pytest.mark.parametrize("law", DRAGS)
def test_wind_drag_damping_and_stiffness_come_from_single_frames(motions, law):
    start = windy(wind=(0, 0, 0), drag=0.1, damping=0.0, stiffness=15.0, law=law)
    found = smooth_balances.values(Objective(start, motions[law], 1e-10), parameters(start))
    np.testing.assert_allclose(found, [1 / 3, DAMPING, DRAGS[law], *WIND], rtol=NEAR)


def test_what_is_known_is_not_changed(motion):
    start = windy(wind=(0, 0, 0))
    known = replace(start, cloths=(replace(start.cloths[0], settings="nn", fits={}),))
    found = smooth_balances.values(Objective(known, motion, 1e-10), parameters(known))
    np.testing.assert_allclose(found, WIND, rtol=NEAR)


def test_where_the_target_shows_too_little_there_is_nothing(motion):
    scene = windy()
    p = parameters(scene)
    few = at_frames(motion, slice(smooth_balances.FEWEST_FRAMES + 1))
    hidden = replace(motion, observed=np.broadcast_to(np.arange(36) != 20, motion.positions.shape[:2]))
    uneven = at_frames(motion, np.array([i for i in range(160) if i % 3 != 2]))
    for target in (few, hidden, uneven):
        assert smooth_balances.values(Objective(scene, target, 1e-10), p) is None
    touching = replace(windy(colliders=[{"type": 1, "pos": {"x": 0, "y": -9, "z": 0}, "rot": dict.fromkeys("xyz", 0),
                                         "scale": dict.fromkeys("xyz", 1)}]))  # fmt: skip
    assert smooth_balances.values(Objective(touching, motion, 1e-10), p) is None


def test_a_fit_in_wind_starts_from_what_frames_show_unless_it_knows_better(motion):
    far, near = windy(wind=(0, 0, 0), drag=0.1), windy()
    objective = Objective(far, motion, 1e-10)
    np.testing.assert_allclose(with_air(objective, parameters(far))[2:], [DRAG, *WIND], rtol=NEAR)
    p = parameters(near)
    assert with_air(Objective(near, motion, 1e-10), p) is p
    calm = replace(far, fits={}, cloths=(replace(far.cloths[0], fits={"damping": "G"}),))
    p = parameters(calm)
    assert with_air(Objective(calm, motion, 1e-10), p) is p


def test_the_drag_may_be_that_of_real_air_on_small_faces():
    (block,) = [each for each in windy(drag=0.1).blocks if each.name == "drag"]
    air = 1.2 / (8 * 0.005**2)  # of 1 m/s on faces of 0.005 m²
    assert windy().cloths[0].air_drag == pytest.approx(air, rel=1e-12)
    assert block.ends == (0.0, 1e4)
    large = replace(windy(drag=2e4))
    assert next(each for each in large.blocks if each.name == "drag").ends == (0.0, pytest.approx(2e7))
    small = replace(large.cloths[0], positions=0.5 * large.cloths[0].positions, drag=0.1)
    assert replace(large, cloths=(small,)).blocks[2].ends == (0.0, pytest.approx(1e3 * 16 * air))
