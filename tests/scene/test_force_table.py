"""Forces as a table: every number reads back as it was, and what is damaged is refused."""

import csv
import io

import numpy as np
import pytest

from clothfit.base.errors import InvalidInput
from clothfit.scene import forces
from clothfit.scene.forces import load_forces

pytestmark = pytest.mark.quick

HEAD = "time,vertex,fx,fy,fz\n"


def some():
    """Times and forces of all sizes, on five of seven vertices."""
    rng = np.random.default_rng(3)
    values = rng.normal(size=(9, 7, 3)) * 10.0 ** rng.integers(-300, 8, (9, 7, 3))
    values[:, [2, 5]] = 0.0
    values[4] = 0.0
    values[0, 0] = [5e-324, -0.1, 1 / 3]
    return 0.02 * np.arange(9), values


def test_it_reads_back_bit_by_bit(tmp_path):
    times, values = some()
    path = tmp_path / "f.csv"
    path.write_bytes(forces.table(times, values))
    found = load_forces(path, 7)
    np.testing.assert_array_equal(found.values, values)
    np.testing.assert_array_equal(found.times, times)


def test_another_reader_finds_the_same_numbers():
    times, values = some()
    rows = list(csv.DictReader(io.StringIO(forces.table(times, values).decode())))
    assert len(rows) == 9 * 5  # what no force acts on is left out
    for row in rows:
        n = int(np.searchsorted(times, float(row["time"])))
        assert [float(row[name]) for name in ("fx", "fy", "fz")] == values[n, int(row["vertex"])].tolist()


def test_no_force_at_all_keeps_the_times(tmp_path):
    path = tmp_path / "f.CSV"
    path.write_bytes(forces.table(np.array([0.0, 0.5]), np.zeros((2, 3, 3))))
    found = load_forces(path, 3)
    assert found.times.tolist() == [0.0, 0.5]
    assert not found.values.any()


def test_lines_in_any_order(tmp_path):
    path = tmp_path / "f.csv"
    path.write_text("time, vertex, fx, fy, fz\r\n0.5,1,1,2,3\r\n0,0,4,5,6\r\n")
    found = load_forces(path, 2)
    assert found.values.tolist() == [[[4, 5, 6], [0, 0, 0]], [[0, 0, 0], [1, 2, 3]]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "its first line must be time,vertex,fx,fy,fz"),
        (HEAD, "it has no line of forces"),
        (HEAD + "0,1,2\n", "its lines have 3 numbers; 5 are needed"),
        (HEAD + "0,0,1,2,x\n", "cannot be read as forces"),
        (HEAD + "0,0,1,2,3\n0.1,7,1,2,3\n", "line 3: 7 is no vertex; there are 7, from 0"),
        (HEAD + "0,0.5,1,2,3\n", "line 2: 0.5 is no vertex"),
        (HEAD + "0,nan,1,2,3\n", "line 2: nan is no vertex"),
        (HEAD + "0,1,1,2,3\n0,1,1,2,3\n", "a vertex has two forces at one time"),
        (HEAD + "0,1,1,2,inf\n", "is not finite"),
        (HEAD + "nan,1,1,2,3\n", "times"),
    ],
)
def test_what_is_damaged_is_refused(tmp_path, text, said):
    path = tmp_path / "f.csv"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=r"f\.csv") as error:
        load_forces(path, 7)
    assert said in str(error.value)


def test_a_table_has_no_feedback(tmp_path):
    path = tmp_path / "f.csv"
    path.write_bytes(forces.table(*some()))
    with pytest.raises(InvalidInput, match="has no gains and places"):
        load_forces(path, 7, pulls=True)


def test_a_table_alone_says_how_many_vertices_it_is_for(tmp_path):
    (tmp_path / "f.csv").write_text("time,vertex,fx,fy,fz\n0,4,1,2,3\n0.5,2,0,0,1\n")
    found = load_forces(tmp_path / "f.csv", None)
    assert found.values.shape == (2, 5, 3)
    assert found.values[0, 4].tolist() == [1, 2, 3]
