"""Markers and the vertices that they show."""

import numpy as np
import pytest
from helpers.scenes import cloth, document

from clothfit import InvalidInput, InvalidMotion, load
from clothfit.formats.animation import Animation
from clothfit.formats.axes import Axes, Reading
from clothfit.motion import foreign
from clothfit.motion.markers import initial

SCENE = load(document(cloth(), cloth(nx=3, vertPos=[{"x": i, "y": 5.0, "z": j} for j in range(3)
                                                             for i in range(3)])))  # fmt: skip
START = initial(SCENE)
CHOSEN = [3, 14, 0]  # vertices of all objects
NAMES = ("left", "right", "far")
VERTICES = tuple(f"v{i}" for i in range(len(START)))


@pytest.fixture
def read(pretend, tmp_path):
    """A function that reads markers as if a file held them, with a map of this text."""

    def found(positions, table=None, names=NAMES, observed=None, file="a.trc", scene=SCENE, **said):
        pretend(Animation(np.asarray(positions, float), Axes("y", "left"), observed=observed, names=names))
        if table is not None:
            (tmp_path / "map.csv").write_text(table, encoding="utf-8")
            said["markers"] = str(tmp_path / "map.csv")
        return foreign.load(file, scene, Reading(**said))

    return found


def moved(frames=4):
    """Three markers, 1, 2 and 3 cm above their vertices at first, that rise."""
    above = np.array([[0, 0.01, 0], [0, 0.02, 0], [0, 0.03, 0]])
    return START[CHOSEN] + above + np.arange(frames)[:, None, None] * [0, 0.1, 0]


def each_of(found):
    """Marker, object and vertex of each."""
    return [match[:3] for match in found.interpretation.matches.each]


def test_markers_belong_to_the_nearest_vertices(read):
    found = read(moved())
    assert each_of(found) == [("left", 0, 3), ("right", 1, 2), ("far", 0, 0)]
    np.testing.assert_allclose([match.distance for match in found.interpretation.matches.each], [0.01, 0.02, 0.03])
    np.testing.assert_allclose(found.motion.positions[:, CHOSEN], moved())
    assert np.flatnonzero(found.motion.observed.any(axis=0)).tolist() == sorted(CHOSEN)
    assert np.isnan(found.motion.positions[:, 1]).all()
    assert "3 markers, the nearest vertex to each, 20 mm away (median), 30 mm at most" in str(found.interpretation)
    summary = found.interpretation.summary()["markers"]
    np.testing.assert_allclose([summary["median"], summary["largest"]], [0.02, 0.03])
    assert summary["each"][1]["vertex"] == 2


def test_a_marker_counts_from_where_it_is_first_seen(read):
    positions = moved()
    positions[:2, 0] = np.nan
    positions[2, 0] = START[5]
    found = read(positions, file="a.c3d", frames="3:")
    assert each_of(found)[0] == ("left", 0, 5)
    assert found.motion.observed[0, 5]


RECTANGLE = load(document(cloth(nx=7, ny=5, spacing=0.1, vertIsFixed=[i >= 28 for i in range(35)])))


@pytest.mark.parametrize(("degrees", "way"), [(4.0, 0.06), (25.0, 0.4), (80.0, 2.0)])
def test_markers_in_another_place_are_matched_once_they_are_moved_and_turned(read, degrees, way):
    """A rectangle fits in four ways, of which two turn it by a right angle at most, and one of these leaves what is
    held still.
    """
    chosen = np.array([0, 3, 6, 9, 12, 15, 18, 26, 28, 31, 34])
    y, c, s = initial(RECTANGLE)[chosen], *(f(np.radians(degrees)) for f in (np.cos, np.sin))
    frames = y + np.sin(np.arange(6.0))[:, None, None] * 0.05 * (chosen < 28)[:, None]
    noise = np.random.default_rng(1).normal(0.0, 2e-3, frames.shape)
    elsewhere = (frames + noise) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + way * np.array([0.6, 0.0, 0.8])
    found = read(elsewhere, names=[str(i) for i in range(len(chosen))], scene=RECTANGLE)
    assert [match.vertex for match in found.interpretation.matches.each] == chosen.tolist()
    assert "once they are moved and turned as a whole" in str(found.interpretation)
    np.testing.assert_allclose(found.motion.positions[:, chosen], elsewhere)  # they stay where they are


def test_other_places_that_fit_as_well_are_named(read):
    """Markers inside fit one edge farther as well."""
    chosen = np.array([8, 9, 10, 15, 17, 22])
    found = read([initial(RECTANGLE)[chosen] + [0.03, 0.2, 0.0]] * 2, names=tuple("abcdef"), scene=RECTANGLE)
    assert found.interpretation.matches.place.others > 0
    assert "as well, and the nearest is taken (--set map says which vertex each is)" in str(found.interpretation)


def test_gaps_are_not_observed_and_a_marker_that_is_never_seen_is_left_out_and_told(read):
    positions, observed = moved(), np.ones((4, 3), bool)
    positions[1, 0] = np.nan
    observed[2, 1] = False
    found = read(positions, observed=observed, file="a.csv").motion
    assert found.observed[:, CHOSEN].tolist() == [[1, 1, 1], [0, 1, 1], [1, 0, 1], [1, 1, 1]]
    assert np.isnan(found.positions[~found.observed]).all()
    positions[:, 2] = np.nan
    taken = read(positions).interpretation
    assert len(taken.matches.each) == 2
    assert 'never seen, and left out: "far"' in taken.notes


def test_a_map_says_which_vertices_they_are(read):
    found = read(moved(), "\ufeffVertex,marker, object ,why\r\n8,right,1,x\r\n\r\n 1 , left , 0\r\n")
    assert each_of(found) == [("left", 0, 1), ("right", 1, 8)]
    assert found.interpretation.notes == ('not in the map, and left out: "far"',)
    np.testing.assert_allclose(found.motion.positions[:, [1, 20]], moved()[:, :2])


def test_markers_without_names_are_counted(read):
    assert [name for name, _, _ in each_of(read(moved(), names=None, file="a.csv"))] == ["0", "1", "2"]
    assert each_of(read(moved(), "marker,object,vertex\n2,0,7\n", names=None, file="a.csv")) == [("2", 0, 7)]


@pytest.mark.parametrize(("file", "names"), [("a.csv", None), ("a.c3d", VERTICES)])
def test_as_many_points_as_vertices_without_names_or_with_theirs_are_the_vertices(read, file, names):
    found = read([START[::-1]], names=names, file=file)
    assert found.interpretation.matches is None
    np.testing.assert_array_equal(found.motion.positions[0], START[::-1])


def test_a_map_also_tells_of_the_points_of_another_mesh(read):
    """As of a mesh with seams that the scene has welded."""
    points, table = [START[[4, 4, 3]]], "marker,object,vertex\n0,0,4\n2,0,3\n"
    found = read(points, table, names=None, file="a.pc2")
    assert np.flatnonzero(found.motion.observed[0]).tolist() == [3, 4]
    np.testing.assert_array_equal(found.motion.positions[0, 3:5], START[3:5])
    with pytest.raises(InvalidInput, match="it names vertices of a scene"):
        read(points, table, scene=None)


def test_without_a_scene_markers_stay_markers(read):
    found = read(moved(), scene=None)
    assert (found.names, found.motion.positions.shape, found.interpretation.matches) == (NAMES, (4, 3, 3), None)


HEAD = "marker,object,vertex\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r'markers "left" and "far" both belong to objects\[0\] vertex 3'),
        ("", "map.csv: line 1: the names of the columns are needed: marker, object, vertex"),
        (HEAD, "map.csv: names no marker"),
        (HEAD + "middle,0,0\n", 'map.csv: line 2: there is no marker "middle"; there are "left"'),
        (HEAD + "left,0,0\nleft,0,1\n", 'map.csv: line 3: the marker "left" is listed twice'),
        (HEAD + "left,0,12\n", r"map.csv: line 2: there is no objects\[0\] vertex 12 in scene"),
        (HEAD + "left,2,0\n", r"line 2: there is no objects\[2\] vertex 0"),
        (HEAD + "left,-1,0\n", r"line 2: there is no objects\[-1\] vertex 0"),
        (HEAD + "left,0\n", r"line 2: there is no objects\[0\] vertex  in"),
        (HEAD + "left,0,1e400\n", r"line 2: there is no objects\[0\] vertex 1e400"),
        (HEAD + "left,0,0\nright,0,0\n", r'map.csv: markers "left" and "right" both belong to'),
    ],
)
def test_a_wrong_map_is_told_with_its_line_and_two_markers_at_one_vertex_are_named(read, text, message):
    with pytest.raises(InvalidMotion, match=message):
        read(moved()[:, [0, 1, 0]], text)
