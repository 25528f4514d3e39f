"""Markers and the vertices that they show."""

import numpy as np
import pytest
from helpers.scenes import cloth, document

import clothfit
from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.formats.animation import Animation
from clothfit.formats.axes import Axes, Reading
from clothfit.motion import foreign
from clothfit.motion.markers import initial

SCENE = clothfit.load(document(cloth(), cloth(nx=3, vertPos=[{"x": i, "y": 5.0, "z": j} for j in range(3)
                                                             for i in range(3)])))  # fmt: skip
START = initial(SCENE)
CHOSEN = [3, 14, 0]  # vertices of all objects
NAMES = ("left", "right", "far")


@pytest.fixture
def markers(pretend):
    """A function that lets every file hold markers."""
    def hold(positions, names=NAMES, observed=None):
        pretend(Animation(np.asarray(positions, float), Axes("y", "left"), observed=observed, names=names))

    return hold


def moved(frames=4):
    """Three markers, 1, 2 and 3 cm above their vertices at first, that rise."""
    above = np.array([[0, 0.01, 0], [0, 0.02, 0], [0, 0.03, 0]])
    return START[CHOSEN] + above + np.arange(frames)[:, None, None] * [0, 0.1, 0]


def written(folder, text):
    path = folder / "map.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_markers_belong_to_the_nearest_vertices(markers):
    markers(moved())
    found = foreign.load("a.trc", SCENE, Reading())
    each = found.interpretation.matches.each
    assert [(match.marker, match.object, match.vertex) for match in each] == [("left", 0, 3), ("right", 1, 2),
                                                                              ("far", 0, 0)]  # fmt: skip
    np.testing.assert_allclose([match.distance for match in each], [0.01, 0.02, 0.03])
    np.testing.assert_allclose(found.motion.positions[:, CHOSEN], moved())
    assert np.flatnonzero(found.motion.observed.any(axis=0)).tolist() == sorted(CHOSEN)
    assert np.isnan(found.motion.positions[:, 1]).all()
    assert "3 markers, the nearest vertex to each, 20 mm away (median), 30 mm at most" in str(found.interpretation)
    summary = found.interpretation.summary()["markers"]
    np.testing.assert_allclose([summary["median"], summary["largest"]], [0.02, 0.03])
    assert summary["each"][1]["vertex"] == 2


def test_a_marker_counts_from_where_it_is_first_seen(markers):
    positions = moved()
    positions[:2, 0] = np.nan
    positions[2, 0] = START[5]
    markers(positions)
    found = foreign.load("a.c3d", SCENE, Reading(frames="3:"))
    assert found.interpretation.matches.each[0].vertex == 5
    assert found.motion.observed[0, 5]


def test_gaps_are_not_observed(markers):
    positions, observed = moved(), np.ones((4, 3), bool)
    positions[1, 0] = np.nan
    observed[2, 1] = False
    markers(positions, observed=observed)
    found = foreign.load("a.csv", SCENE, Reading()).motion
    assert found.observed[:, CHOSEN].tolist() == [[1, 1, 1], [0, 1, 1], [1, 0, 1], [1, 1, 1]]
    assert np.isnan(found.positions[~found.observed]).all()


def test_a_marker_that_is_never_seen_is_left_out_and_told(markers):
    positions = moved()
    positions[:, 2] = np.nan
    markers(positions)
    found = foreign.load("a.trc", SCENE, Reading()).interpretation
    assert len(found.matches.each) == 2
    assert 'never seen, and left out: "far"' in found.notes


def test_a_map_says_which_vertices_they_are(markers, tmp_path):
    markers(moved())
    path = written(tmp_path, "\ufeffVertex,marker, object ,why\r\n8,right,1,x\r\n\r\n 1 , left , 0\r\n")
    found = foreign.load("a.trc", SCENE, Reading(markers=path))
    assert [match[:3] for match in found.interpretation.matches.each] == [("left", 0, 1), ("right", 1, 8)]
    assert found.interpretation.notes == ('not in the map, and left out: "far"',)
    np.testing.assert_allclose(found.motion.positions[:, [1, 20]], moved()[:, :2])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_map_has_line_ends_of_any_kind(markers, tmp_path, end):
    markers(moved())
    (tmp_path / "map.csv").write_bytes(f"marker,object,vertex{end}far,0,1{end}".encode())
    found = foreign.load("a.trc", SCENE, Reading(markers=tmp_path / "map.csv"))
    assert [match[:3] for match in found.interpretation.matches.each] == [("far", 0, 1)]


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_map_has_separators_as_tables_have(markers, tmp_path, separator):
    markers(moved())
    text = "vertex,marker,object\n1,far,0\n".replace(",", separator)
    found = foreign.load("a.trc", SCENE, Reading(markers=written(tmp_path, text)))
    assert [match[:3] for match in found.interpretation.matches.each] == [("far", 0, 1)]


def test_markers_without_names_are_counted(markers, tmp_path):
    markers(moved(), names=None)
    assert [m.marker for m in foreign.load("a.csv", SCENE, Reading()).interpretation.matches.each] == ["0", "1", "2"]
    path = written(tmp_path, "marker,object,vertex\n2,0,7\n")
    assert foreign.load("a.csv", SCENE, Reading(markers=path)).interpretation.matches.each[0].vertex == 7


def test_as_many_points_as_vertices_without_names_are_the_vertices(markers):
    markers([START[::-1]], names=None)
    found = foreign.load("a.csv", SCENE, Reading())
    assert found.interpretation.matches is None
    np.testing.assert_array_equal(found.motion.positions[0], START[::-1])


def test_a_map_also_tells_of_the_points_of_another_mesh(markers, tmp_path):
    """As of a mesh with seams that the scene has welded."""
    markers([START[[4, 4, 3]]], names=None)
    path = written(tmp_path, "marker,object,vertex\n0,0,4\n2,0,3\n")
    found = foreign.load("a.pc2", SCENE, Reading(markers=path))
    assert np.flatnonzero(found.motion.observed[0]).tolist() == [3, 4]
    np.testing.assert_array_equal(found.motion.positions[0, 3:5], START[3:5])
    with pytest.raises(InvalidInput, match="it names vertices of a scene"):
        foreign.load("a.pc2", None, Reading(markers=path))


def test_points_with_the_names_of_the_vertices_are_the_vertices(markers):
    markers([START[::-1]], names=tuple(f"v{i}" for i in range(len(START))))
    found = foreign.load("a.c3d", SCENE, Reading())
    assert found.interpretation.matches is None
    np.testing.assert_array_equal(found.motion.positions[0], START[::-1])


def test_without_a_scene_markers_stay_markers(markers):
    markers(moved())
    found = foreign.load("a.trc", None, Reading())
    assert (found.names, found.motion.positions.shape, found.interpretation.matches) == (NAMES, (4, 3, 3), None)


def test_two_markers_at_one_vertex_are_named(markers):
    markers(moved()[:, [0, 1, 0]])
    with pytest.raises(InvalidMotion, match=r'markers "left" and "far" both belong to objects\[0\] vertex 3'):
        foreign.load("a.trc", SCENE, Reading())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "map.csv: line 1: the names of the columns are needed: marker, object, vertex"),
        ("marker,object,vertex\n", "map.csv: names no marker"),
        ("marker,object,vertex\nmiddle,0,0\n", 'map.csv: line 2: there is no marker "middle"; there are "left"'),
        ("marker,object,vertex\nleft,0,0\nleft,0,1\n", 'map.csv: line 3: the marker "left" is listed twice'),
        ("marker,object,vertex\nleft,0,12\n", r"map.csv: line 2: there is no objects\[0\] vertex 12 in scene"),
        ("marker,object,vertex\nleft,2,0\n", r"line 2: there is no objects\[2\] vertex 0"),
        ("marker,object,vertex\nleft,-1,0\n", r"line 2: there is no objects\[-1\] vertex 0"),
        ("marker,object,vertex\nleft,0\n", r"line 2: there is no objects\[0\] vertex  in"),
        ("marker,object,vertex\nleft,0,1e400\n", r"line 2: there is no objects\[0\] vertex 1e400"),
        ("marker,object,vertex\nleft,0,0\nright,0,0\n", r'map.csv: markers "left" and "right" both belong to'),
    ],
)
def test_a_wrong_map_is_told_with_its_line(markers, tmp_path, text, message):
    markers(moved())
    with pytest.raises(InvalidMotion, match=message):
        foreign.load("a.trc", SCENE, Reading(markers=written(tmp_path, text)))
