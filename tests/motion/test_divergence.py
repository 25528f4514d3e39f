"""Where a motion diverged, and the states before."""

import io

import numpy as np
import pytest
from helpers.physics import METHODS, scene, thing

from clothfit.base.limits import FARTHEST
from clothfit.engine import tape
from clothfit.engine.march import velocity
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.divergence import OVERSTRETCHED, STATES_KEPT, Diverged, dump, overstretched_from, worst
from clothfit.motion.simulate import simulate

STIFF = {"mass": 0.5, "stiffness": 2e4, "fixed": [0]}


def wild(method="symplectic", **fields):
    """A calm object and one that diverges."""
    calm = thing([(0, 0, 0)])
    pair = thing([(0, 0, 0), (0, -1, 0), (5, 0, 0)], [(0, 1)], **STIFF)
    return scene(calm, pair, integrationMethod=METHODS[method], delta=0.011, optimizationIterations=160, **fields)


def fault_of(made):
    with pytest.raises(Diverged) as caught:
        simulate(made)
    return caught.value


@pytest.mark.parametrize("length", [1, 3, 16])
@pytest.mark.parametrize("method", ["explicit", "symplectic"])
def test_the_last_states_are_those_of_the_steps_whatever_the_parts(method, length, monkeypatch):
    monkeypatch.setattr(tape, "SHORTEST_PART", length)
    monkeypatch.setattr(tape, "STRETCH", 1)
    made = wild(method)
    error = fault_of(made)
    memory, good = rollout(build(made, 1), 159, made.tolerance)
    assert (error.step, error.fault.cloth) == (good + 1, 1)
    states = error.fault.states
    assert good > STATES_KEPT
    assert states.steps.tolist() == [*range(good + 1 - STATES_KEPT, good + 1), good + 1]
    np.testing.assert_array_equal(states.x, memory.x[states.steps])
    np.testing.assert_array_equal(states.v, [velocity(memory, t) for t in states.steps])
    assert error.fault.vertex == 1


def test_a_motion_that_diverges_at_once_has_its_start():
    one = thing([(0, 0, 0), (1, 0, 0), (0, 0, 1)], [(0, 1)], [(0, 1, 2)], dragCoefficient=1.0)
    error = fault_of(scene(one, windVel={"x": 0, "y": 1e150, "z": 0}, optimizationIterations=10))
    assert (error.step, len(error.motion.positions)) == (1, 1)
    assert str(error).endswith("try a smaller delta")  # of implicit steps there is no limit to name
    states = error.fault.states
    assert states.steps.tolist() == [0, 1]
    assert np.isfinite(states.x[0]).all()
    assert np.abs(states.x[1]).max() > FARTHEST


def test_the_vertex_that_left_first():
    x = np.zeros((4, 3))
    v = np.array([[0, 0, 0], [1, 0, 0], [0, -9, 0], [99, 0, 0.0]])
    far = x.copy()
    far[1, 2] = -2e12
    assert worst(far, v) == 1  # the farthest
    lost = x.copy()
    lost[:3] = np.nan
    assert worst(lost, v) == 2  # the fastest of those that are not finite
    lost[2] = np.inf
    assert worst(lost, v) == 2


def test_a_dump_holds_what_its_docstring_says():
    made = wild()
    error = fault_of(made)
    file = io.BytesIO()
    dump(made, error.fault)(file)
    file.seek(0)
    with np.load(file, allow_pickle=False) as found:
        arrays = dict(found)
    states = error.fault.states
    np.testing.assert_array_equal(arrays["positions"], states.x)
    np.testing.assert_array_equal(arrays["velocities"], states.v)
    np.testing.assert_allclose(arrays["times"], 0.011 * states.steps)
    assert arrays["springs"].tolist() == [[0, 1]]
    np.testing.assert_allclose(arrays["stretch"][:-1, 0], np.linalg.norm(states.x[:-1, 1], axis=1))
    assert (int(arrays["object"]), int(arrays["vertex"]), float(arrays["delta"])) == (1, 1, 0.011)
    assert set(arrays) == {
        *("positions", "velocities", "steps", "times", "springs", "stretch", "object", "vertex", "delta")
    }


def test_from_which_frame_on_springs_are_too_long():
    made = scene(thing([(0, 0, 0), (1, 0, 0)], [(0, 1)]))
    lengths = np.array([1.0, 2 * OVERSTRETCHED, 3.0, OVERSTRETCHED, 1.1 * OVERSTRETCHED, 1e9])
    x = lengths[:, None, None] * np.array([[0, 0, 0], [1.0, 0, 0]])
    assert overstretched_from(made, 0, x) == 4  # from there to the end
    assert overstretched_from(made, 0, x[:4]) is None
    assert overstretched_from(made, 0, x[:2]) == 1
