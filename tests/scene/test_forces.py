"""Forces over time: when each row acts, and what of a file is refused."""

import numpy as np
import pytest

from clothfit.base import npz
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import write_atomically
from clothfit.scene.forces import Forces, load_forces, save_forces


def three():
    """Rows that begin at 0, 0.1 and 0.2 s, on two vertices."""
    return Forces(np.array([0.0, 0.1, 0.2]), np.arange(18.0).reshape(3, 2, 3))


def test_a_row_acts_until_the_next_and_the_last_as_long_as_the_one_before():
    times = np.array([-0.1, 0.0, 0.05, 0.1 - 1e-9, 0.15, 0.2, 0.29, 0.3, 5.0])
    values, gain, places = three().at(times)
    rows = [np.zeros((2, 3)), *three().values[[0, 0, 1, 1, 2, 2]], np.zeros((2, 3)), np.zeros((2, 3))]
    assert values.tolist() == np.array(rows).tolist()  # a step that begins 1e-9 s early is meant to begin with the row
    assert (gain, places) == (None, None)


def test_what_is_saved_is_read_again(tmp_path):
    path = tmp_path / "f.npz"
    whole = Forces(three().times, three().values, np.ones((3, 2)), np.zeros((3, 2, 3)))
    save_forces(whole, path)
    again = load_forces(path, 2, pulls=True)
    for name in ("times", "values", "gain", "places"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    assert again.pulls
    save_forces(three(), path)
    with pytest.raises(InvalidInput, match=r"^f\.npz: has no gains and places for a feedback"):
        load_forces(path, 2, pulls=True)


FAULTS = {
    "another cloth": ({}, 3, "are for 2 vertices; the scene has 3"),
    "no times": ({"times": None}, 2, "there is no array times"),
    "other times": ({"times": np.zeros(2)}, 2, "times: have the shape (2,) for 3 rows"),
    "times that stay": ({"times": np.zeros(3)}, 2, "times[1]: is not later than the one before it"),
    "no numbers": ({"times": np.array([0, np.nan, 1])}, 2, "times[1]: is not later"),
    "NaN": ({"forces": np.full((3, 2, 3), np.nan)}, 2, "forces[0][0]: is not finite"),
    "too strong": ({"forces": np.full((3, 2, 3), 1e10)}, 2, "forces[0][0]: is not finite and at most 1e+09 N"),
    "no vectors": ({"forces": np.zeros((3, 2))}, 2, "have the shape (3, 2); (steps, vertices, 3) is needed"),
    "text": ({"times": np.array(["a", "b", "c"])}, 2, "times has the type <U1; numbers are needed"),
    "half a feedback": ({"gain": np.zeros((3, 2))}, 2, "gain and places belong together"),
    "another feedback": ({"gain": np.zeros((2, 2)), "places": np.zeros((3, 2, 3))}, 2, "do not fit forces (3, 2, 3)"),
    "it pushes away": ({"gain": -np.ones((3, 2)), "places": np.zeros((3, 2, 3))}, 2, "gain must be within 0 "),
    "no rows": ({"forces": np.zeros((0, 2, 3)), "times": np.zeros(0)}, 2, "times: is empty"),
}


@pytest.mark.parametrize(("change", "vertices", "said"), FAULTS.values(), ids=list(FAULTS))
def test_files_that_do_not_fit_are_refused(tmp_path, change, vertices, said):
    arrays = {"forces": three().values, "times": three().times} | change
    path = tmp_path / "f.npz"
    write_atomically(path, npz.archive({name: array for name, array in arrays.items() if array is not None}))
    with pytest.raises(InvalidInput) as refused:
        load_forces(path, vertices)
    assert said in str(refused.value)
    assert str(refused.value).startswith("f.npz: ")


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="there is no such file"):
        load_forces(tmp_path / "none.npz", 2)
    (tmp_path / "f.npz").write_text("forces")
    with pytest.raises(InvalidInput, match=r"^f\.npz: cannot be read as forces"):
        load_forces(tmp_path / "f.npz", 2)


def gains(**change):
    """The arrays of a feedback in two shapes and with one shape of forces, on two vertices and over three rows."""
    made = {"measure": np.eye(2), "push": np.ones((2, 1)), "gains": np.ones((1, 3, 3, 12))}
    return {**made, "reference": np.zeros((1, 3, 12)), "bound": np.array(2.0), **change}


def test_gains_are_read_with_their_forces(tmp_path):
    path = tmp_path / "f.npz"
    write_atomically(path, npz.archive({"forces": three().values, "times": three().times, **gains()}))
    found = load_forces(path, 2, pulls=True).regulator
    x, v = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.full((2, 3), 0.5)
    answer = found.answer(0, slice(0, 2), 1, np.zeros(12), x, v)
    np.testing.assert_allclose(answer, np.full((2, 3), -(x.sum() + v.sum())), rtol=1e-15)  # all gains are 1
    assert found.bound == 2.0


GAINS = {
    "half of it": ({"push": None}, "belong together; missing: push"),
    "other vertices": ({"measure": np.eye(3)}, "measure (3, 3) and push (2, 1) do not fit 2 vertices"),
    "other rows": ({"gains": np.ones((1, 2, 3, 12))}, "(objects, 3, 3, 12) and (objects, 3, 12) are needed"),
    "other shapes": ({"reference": np.zeros((1, 3, 6))}, "do not fit forces, measure and push"),
    "NaN": ({"gains": np.full((1, 3, 3, 12), np.nan)}, "gains: is not finite everywhere"),
    "no bound": ({"bound": np.array(-1.0)}, "bound: must be one number above 0"),
}


@pytest.mark.parametrize(("change", "said"), GAINS.values(), ids=list(GAINS))
def test_gains_that_do_not_fit_are_refused(tmp_path, change, said):
    arrays = {"forces": three().values, "times": three().times, **gains(**change)}
    path = tmp_path / "f.npz"
    write_atomically(path, npz.archive({name: array for name, array in arrays.items() if array is not None}))
    with pytest.raises(InvalidInput) as refused:
        load_forces(path, 2)
    assert said in str(refused.value)
    assert str(refused.value).startswith("f.npz: ")
