"""Forces over time: when each row acts, that files and tables read back as they were, and what is refused of them."""

import csv
import io

import numpy as np
import pytest

from clothfit import Forces, InvalidInput, load_forces, save_forces
from clothfit.base import npz
from clothfit.base.writing import write_atomically
from clothfit.scene import forces


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


def gains(**change):
    """The arrays of a feedback in two shapes and with one shape of forces, on two vertices and over three rows."""
    made = {"measure": np.eye(2), "push": np.ones((2, 1)), "gains": np.ones((1, 3, 3, 12))}
    return {**made, "reference": np.zeros((1, 3, 12)), "bound": np.array(2.0), **change}


FAULTS |= {
    "half of gains": (gains(push=None), 2, "belong together; missing: push"),
    "gains of others": (gains(measure=np.eye(3)), 2, "measure (3, 3) and push (2, 1) do not fit 2 vertices"),
    "rows of gains": (gains(gains=np.ones((1, 2, 3, 12))), 2, "(objects, 3, 3, 12) and (objects, 3, 12) are needed"),
    "shapes of gains": (gains(reference=np.zeros((1, 3, 6))), 2, "do not fit forces, measure and push"),
    "NaN in gains": (gains(gains=np.full((1, 3, 3, 12), np.nan)), 2, "gains: is not finite everywhere"),
    "no bound": (gains(bound=np.array(-1.0)), 2, "bound: must be one number above 0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_files_that_do_not_fit_are_refused(tmp_path, fault):
    change, vertices, said = FAULTS[fault]
    arrays = {"forces": three().values, "times": three().times} | change
    path = tmp_path / "f.npz"
    write_atomically(path, npz.archive({name: array for name, array in arrays.items() if array is not None}))
    with pytest.raises(InvalidInput) as refused:
        load_forces(path, vertices)
    assert said in str(refused.value)
    assert str(refused.value).startswith("f.npz: ")


def test_gains_are_read_with_their_forces(tmp_path):
    path = tmp_path / "f.npz"
    with pytest.raises(InvalidInput, match=r"^f\.npz: there is no such file"):
        load_forces(path, 2)
    path.write_text("forces")
    with pytest.raises(InvalidInput, match=r"^f\.npz: cannot be read as forces"):
        load_forces(path, 2)
    write_atomically(path, npz.archive({"forces": three().values, "times": three().times, **gains()}))
    found = load_forces(path, 2, pulls=True).regulator
    x, v = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.full((2, 3), 0.5)
    answer = found.answer(0, slice(0, 2), 1, np.zeros(12), x, v)
    np.testing.assert_allclose(answer, np.full((2, 3), -(x.sum() + v.sum())), rtol=1e-15)  # all gains are 1
    assert found.bound == 2.0


# The same as a table.


HEAD = "time,vertex,fx,fy,fz\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "its first line must be time,vertex,fx,fy,fz"),
        (HEAD, "it has no line of forces"),
        (HEAD + "0,1,2\n", "its lines have 3 numbers; 5 are needed"),
        (HEAD + "0,0,1,2,x\n", "cannot be read as forces"),
        (HEAD + "0,0,1,2,3\n0.1,7,1,2,3\n", "line 3: 7 is no vertex; there are 7, from 0"),
        (HEAD + "0,0.5,1,2,3\n", "line 2: 0.5 is no vertex"),
        (HEAD + "0,1,1,2,3\n0,1,1,2,3\n", "a vertex has two forces at one time"),
    ],
)
def test_what_is_damaged_is_refused(tmp_path, text, said):
    path = tmp_path / "f.csv"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=r"f\.csv") as error:
        load_forces(path, 7)
    assert said in str(error.value)


def test_it_reads_back_bit_by_bit_and_another_reader_finds_the_same(tmp_path):
    """Forces of all sizes, on five of seven vertices."""
    rng, times, path = np.random.default_rng(3), 0.02 * np.arange(9), tmp_path / "f.csv"
    values = rng.normal(size=(9, 7, 3)) * 10.0 ** rng.integers(-300, 8, (9, 7, 3))
    values[:, [2, 5]] = 0.0
    values[4] = 0.0
    values[0, 0] = [5e-324, -0.1, 1 / 3]
    path.write_bytes(forces.table(times, values))
    found = load_forces(path, 7)
    np.testing.assert_array_equal(found.values, values)
    np.testing.assert_array_equal(found.times, times)
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    assert len(rows) == 9 * 5  # what no force acts on is left out
    for row in rows:
        n = int(np.searchsorted(times, float(row["time"])))
        assert [float(row[name]) for name in ("fx", "fy", "fz")] == values[n, int(row["vertex"])].tolist()
    with pytest.raises(InvalidInput, match="has no gains and places"):
        load_forces(path, 7, pulls=True)


@pytest.mark.parametrize(
    ("data", "vertices", "times", "values"),
    [
        (forces.table(np.array([0.0, 0.5]), np.zeros((2, 3, 3))), 3, [0, 0.5], [[[0, 0, 0]] * 3] * 2),
        (b"time, vertex, fx, fy, fz\r\n0.5,1,1,2,3\r\n0,0,4,5,6\r\n", 2, [0, 0.5],
         [[[4, 5, 6], [0, 0, 0]], [[0, 0, 0], [1, 2, 3]]]),  # lines in any order
        (b"time,vertex,fx,fy,fz\n0,1,1,2,3\n0.5,0,0,0,1\n", None, [0, 0.5],
         [[[0, 0, 0], [1, 2, 3]], [[0, 0, 1], [0, 0, 0]]]),  # as many vertices as it names
    ],
)  # fmt: skip
def test_tables_of_other_programs(tmp_path, data, vertices, times, values):
    (tmp_path / "f.CSV").write_bytes(data)
    found = load_forces(tmp_path / "f.CSV", vertices)
    assert (found.times.tolist(), found.values.tolist()) == (times, values)
