"""Where a motion diverged, and the states before."""

import io

import numpy as np
import pytest
from helpers.physics import METHODS, scene, thing

from clothfit.base.limits import FARTHEST
from clothfit.engine import tape
from clothfit.engine.rollout import rollout
from clothfit.engine.step.states import velocity
from clothfit.engine.system import build
from clothfit.motion.divergence import OVERSTRETCHED, STATES_KEPT, Diverged, dump, overstretched_from, worst
from clothfit.motion.simulate import simulate


def diverged(made):
    """The error of a simulation that diverges."""
    with pytest.raises(Diverged) as caught:
        simulate(made)
    return caught.value


@pytest.mark.parametrize("length", [1, 3, 16])
@pytest.mark.parametrize("method", ["explicit", "symplectic"])
def test_the_last_states_are_those_of_the_steps_whatever_the_parts_and_a_dump_holds_them(method, length, monkeypatch):
    monkeypatch.setattr(tape, "SHORTEST_PART", length)
    monkeypatch.setattr(tape, "STRETCH", 1)
    pair = thing([(0, 0, 0), (0, -1, 0), (5, 0, 0)], [(0, 1)], mass=0.5, stiffness=2e4, fixed=[0])
    fields = {"integrationMethod": METHODS[method], "delta": 0.011, "optimizationIterations": 160}
    made = scene(thing([(0, 0, 0)]), pair, **fields)  # a calm object and one that diverges
    error = diverged(made)
    memory, good = rollout(build(made, 1), 159, made.tolerance)
    assert (error.step, error.fault.cloth, error.fault.vertex) == (good + 1, 1, 1)
    assert good > STATES_KEPT
    steps = np.arange(good + 1 - STATES_KEPT, good + 2)
    x, v = memory.x[steps], np.array([velocity(memory, t) for t in steps])
    for found, true in zip(error.fault.states, (steps, x, v), strict=True):
        np.testing.assert_array_equal(found, true)
    file = io.BytesIO()
    dump(made, error.fault)(file)
    file.seek(0)
    with np.load(file, allow_pickle=False) as held:
        arrays = dict(held)
    expected = {"positions": x, "velocities": v, "steps": steps, "times": 0.011 * steps, "springs": [[0, 1]],
                "object": 1, "vertex": 1, "delta": 0.011}  # fmt: skip
    stretch = arrays.pop("stretch")
    assert set(arrays) == set(expected)
    for name, array in expected.items():
        np.testing.assert_allclose(arrays[name], array, rtol=1e-15)
    np.testing.assert_allclose(stretch[:-1, 0], np.linalg.norm(x[:-1, 1], axis=1))


def test_a_motion_that_diverges_at_once_has_its_start():
    one = thing([(0, 0, 0), (1, 0, 0), (0, 0, 1)], [(0, 1)], [(0, 1, 2)], dragCoefficient=1.0)
    error = diverged(scene(one, windVel={"x": 0, "y": 1e150, "z": 0}, optimizationIterations=10))
    assert (error.step, len(error.motion.positions)) == (1, 1)
    assert str(error).endswith("try a smaller delta")  # of implicit steps there is no limit to name
    states = error.fault.states
    assert states.steps.tolist() == [0, 1]
    assert np.isfinite(states.x[0]).all()
    assert np.abs(states.x[1]).max() > FARTHEST


def test_the_vertex_that_left_first():
    v = np.array([[0, 0, 0], [1, 0, 0], [0, -9, 0], [99, 0, 0.0]])
    far, lost = np.zeros((2, 4, 3))
    far[1, 2] = -2e12
    assert worst(far, v) == 1  # the farthest
    lost[:3] = np.nan
    assert worst(lost, v) == 2  # the fastest of those that are not finite
    lost[2] = np.inf
    assert worst(lost, v) == 2


def test_from_which_frame_on_springs_are_too_long():
    made = scene(thing([(0, 0, 0), (1, 0, 0)], [(0, 1)]))
    lengths = np.array([1.0, 2 * OVERSTRETCHED, 3.0, OVERSTRETCHED, 1.1 * OVERSTRETCHED, 1e9])
    x = lengths[:, None, None] * np.array([[0, 0, 0], [1.0, 0, 0]])
    # the first from which on to the end of so many frames
    assert [overstretched_from(made, 0, x[:count]) for count in (6, 4, 2)] == [4, None, 1]
