"""Edges, parts and places of meshes, against trimesh and the builder of springs."""

import numpy as np
import pytest
import trimesh

from clothfit import InvalidInput
from clothfit.meshes import mesh
from clothfit.meshes.topology import across, components, edges, first_of_each, together


def test_the_sizes_of_parts_are_those_of_trimesh():
    solids = [trimesh.creation.icosphere(n).apply_translation([4 * n, 0, 0]) for n in (0, 2, 1)]
    joined = trimesh.util.concatenate(solids)
    sizes, first = components(joined.edges.astype(np.int32), len(joined.vertices))
    assert sizes.tolist() == sorted((len(solid.vertices) for solid in solids), reverse=True)
    assert len(sizes) == joined.body_count
    assert sorted(first.tolist()) == [0, 12, 174]  # behind 12 and 162 vertices


def test_places_are_one_from_each_to_the_next():
    row = np.array([[0.0, 0, 0], [5, 0, 0], [1, 0, 0], [2, 0, 0], [5.5, 0, 0]])
    assert together(row, 1.0).tolist() == [0, 1, 0, 0, 1]
    assert together(row, 0.9).tolist() == [0, 1, 2, 3, 1]
    assert together(row[[0, 0, 1]], 0.0).tolist() == [0, 0, 2]


def test_a_distance_that_joins_everything_is_refused_before_it_takes_memory():
    with pytest.raises(InvalidInput, match="too many others"):
        together(np.random.default_rng(0).random((20_000, 3)), 10.0)


def test_pairs_across_are_those_of_the_bending_springs():
    sheet = mesh.plane(6, 2.0, 1.0)
    made = mesh.springs(sheet, 1.0)
    pairs = across(edges(sheet.triangles))
    assert sorted(map(tuple, pairs.tolist())) == sorted(map(tuple, made.ends[made.bends].tolist()))


def test_edges_are_those_of_trimesh():
    solid = trimesh.creation.icosphere(1)
    met = edges(solid.faces.astype(np.int32))
    np.testing.assert_array_equal(met.ends, np.sort(np.unique(np.sort(solid.edges, axis=1), axis=0), axis=1))
    assert (met.count == 2).all()
    assert (np.bincount(met.of, met.along) == 1).all()  # a closed solid: once each way


def test_the_first_of_equal_rows_is_kept():
    rows = np.array([[3, 1], [0, 2], [3, 1], [0, 2], [1, 3]], np.int32)
    assert first_of_each(rows).tolist() == [True, True, False, False, True]
    assert first_of_each(np.zeros((0, 3), np.int32)).tolist() == []
