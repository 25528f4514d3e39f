"""CSV files of Vicon Nexus: other sections, velocities, gaps, damage. One of Nexus itself: test_other_programs."""

import numpy as np
import pytest

from clothfit.base.errors import InvalidMotion
from clothfit.formats import marker_table
from clothfit.formats.axes import Axes

DEVICES = "Devices\n1000\n,,plate - Force,,\nFrame,Sub Frame,Fx,Fy,Fz\n,,N,N,N\n7,0,1,2,3\n7,1,1,2,3\n\n"
TRAJECTORIES = (
    "Trajectories,,,,,,,,,,,,,,\n200\n,,Anna:hem,,,,,,Anna:cuff,,,*7,,\n"
    "Frame,Sub Frame,X,Y,Z,X',Y',Z',X,Y,Z,X,Y,Z\n,,m,m,m,m/s,m/s,m/s,m,m,m,m,m,m\n"
    "7,0,1,2,3,9,9,9,4,5,6,,,\n9,0,1.5,2,3,9,9,9,,,,7,8,9\n\n"
)


@pytest.fixture
def read(tmp_path):
    def reading(text):
        (tmp_path / "a.csv").write_text(text)
        return marker_table.read(tmp_path / "a.csv")

    return reading


@pytest.mark.parametrize("before", ["", DEVICES])
@pytest.mark.parametrize("after", ["", DEVICES])
def test_positions_of_the_trajectories_are_read_with_their_rate_and_gaps(read, before, after):
    found = read(before + TRAJECTORIES + after)
    assert found.names == ("Anna:hem", "Anna:cuff", "*7")
    assert found.axes == Axes("z", "right", 1.0)
    np.testing.assert_array_equal(found.times, [0, 2 / 200])
    np.testing.assert_array_equal(found.observed, [[True, True, False], [True, False, True]])
    np.testing.assert_array_equal(found.positions[:, 0], [[1, 2, 3], [1.5, 2, 3]])
    np.testing.assert_array_equal(found.positions[1, 2], [7, 8, 9])


def test_semicolons_and_decimal_commas(read):
    text = TRAJECTORIES.replace(",", ";").replace("1.5", "1,5")
    np.testing.assert_array_equal(read(text).positions[1, 0], [1.5, 2, 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (DEVICES, "it has no Trajectories, only Devices; export the trajectories from Nexus"),
        (TRAJECTORIES.replace("200", "fast"), 'line 2: "fast" is not a number'),
        (TRAJECTORIES.replace("200", "0"), "line 2: the rate must be above 0; 0 was given"),
        (DEVICES + TRAJECTORIES.replace("1.5", "l.5"), 'line 15: "l.5" is not a number'),
        (TRAJECTORIES.replace("9,0,1.5", ",0,1.5"), 'line 7: "" is no frame number'),
        ("Trajectories\n", "line 2: the rate must be above 0; nan was given"),
        ("Trajectories\n100\n\nFrame,Sub Frame\n\n", "there are no markers in it"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(read, text, message):
    with pytest.raises(InvalidMotion) as caught:
        read(text)
    assert str(caught.value) == f"a.csv: {message}"
