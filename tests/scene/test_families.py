"""Which springs share a parameter in mode R: families by the directions of a grid, none on irregular meshes."""


import numpy as np
import pytest
from helpers.scenes import changed, cloth, document, problems
from scipy.spatial import Delaunay

from clothfit.meshes.mesh import Mesh, plane, springs
from clothfit.meshes.new_scene import new_scene
from clothfit.scene.families import FAMILIES, families_of, spring_groups, vertex_groups
from clothfit.scene.scene import load

ALL = (
    "edges along", "edges across", "edges diagonal", "bending along", "bending across", "bending diagonal",
)  # fmt: skip


def sizes(groups):
    return dict(zip(groups.names, np.bincount(groups.of).tolist(), strict=True))


def counts(mesh):
    return sizes(spring_groups(new_scene(mesh).cloths[0]))


def of_plane(columns, rows):
    """The families of a plane of so many cells, counted by hand."""
    return {
        "edges along": columns * (rows + 1), "edges across": rows * (columns + 1), "edges diagonal": columns * rows,
        "bending along": rows * (columns - 1), "bending across": columns * (rows - 1),
        "bending diagonal": columns * rows,
    }  # fmt: skip


def rolled(mesh, radius, axis):
    """A plane in x and z, rolled isometrically about x (axis 0) or z (axis 2)."""
    x, _, z = mesh.positions.T
    along, around = (x, z) if axis == 0 else (z, x)
    turned = radius * np.sin(around / radius), radius * np.cos(around / radius)
    rows = (along, turned[1], turned[0]) if axis == 0 else (turned[0], turned[1], along)
    return Mesh(np.stack(rows, axis=1), mesh.triangles)


@pytest.mark.parametrize(
    ("divisions", "width", "height"), [(10, 1.0, 1.0), (10, 3.0, 1.0), (7, 1.0, 2.5), (0, 1.0, 1.0)]
)
def test_a_plane_has_its_directions(divisions, width, height):
    mesh = plane(divisions, width, height)
    columns = int((np.abs(mesh.positions[:, 2] - mesh.positions[0, 2]) < 1e-9).sum())
    rows = len(mesh.positions) // columns
    found = counts(mesh)
    assert found == {name: count for name, count in of_plane(columns - 1, rows - 1).items() if count}


def stretched(mesh, rng):
    """Cells need not be squares."""
    return mesh._replace(positions=mesh.positions * [1.0, 1.0, 4.0])


def turned(mesh, rng):
    """In single precision."""
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return mesh._replace(positions=(mesh.positions @ q).astype(np.float32).astype(float))


def renumbered(mesh, rng):
    """With other numbers of vertices and triangles."""
    order = rng.permutation(len(mesh.positions))
    triangles = np.argsort(order)[mesh.triangles][rng.permutation(len(mesh.triangles))]
    spun = np.stack([np.roll(row, k) for row, k in zip(triangles, rng.integers(0, 3, len(triangles)), strict=True)])
    return Mesh(mesh.positions[order], spun.astype(np.int32))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("changed", "named"),
    [(stretched, True), (renumbered, True), (turned, False),
     *[(lambda mesh, _, r=radius, a=axis: rolled(mesh, r, a), False) for radius in (0.2, 0.5) for axis in (0, 2)]],
)  # fmt: skip
def test_a_plane_that_is_stretched_turned_rolled_or_renumbered_has_the_same_families(changed, named, seed):
    mesh = plane(9, 1.0, 0.6)
    found, flat = counts(changed(mesh, np.random.default_rng(seed))), counts(mesh)
    assert sorted(found.values()) == sorted(flat.values())
    assert set(found) == set(ALL)
    assert found == flat or not named  # which direction is called along depends on the axes


@pytest.mark.parametrize("count", [30, 100, 1000])
@pytest.mark.parametrize("seed", range(5))
def test_an_irregular_mesh_has_no_directions(count, seed):
    points = np.random.default_rng(seed).random((count, 2))
    triangles = Delaunay(points).simplices.astype(np.int32)
    assert set(counts(Mesh(np.column_stack([points, np.zeros(count)]), triangles))) == {"edges", "bending"}


def test_a_cube_has_no_directions():
    """Three cells meet at each corner, so their directions contradict each other."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    assert set(counts(Mesh(corners, np.array(triangles, np.int32)))) == {"edges", "bending"}


def test_the_bending_springs_are_named_by_the_direction_in_which_they_bend():
    """A bending spring over an edge across the cloth bends it along: its ends are two columns apart."""
    mesh = plane(5, 1.0)
    groups = spring_groups(new_scene(mesh).cloths[0])
    ends = springs(mesh, 1.0).ends
    columns, rows = np.abs(ends[:, 0] % 7 - ends[:, 1] % 7), np.abs(ends[:, 0] // 7 - ends[:, 1] // 7)
    names = np.array(groups.names)[groups.of]
    assert set(columns[names == "bending along"].tolist()) == {2}
    assert set(rows[names == "bending across"].tolist()) == {2}
    assert set(rows[names == "edges along"].tolist()) == {0}


def test_flexion_springs_over_two_cells_in_a_row_bend():
    """Springs from each vertex to the second next one in its row or column, as many simulators have them."""
    mesh = plane(4, 1.0)
    index = np.arange(36).reshape(6, 6)
    rows = [index[:, :-2], index[:, 2:]], [index[:-2], index[2:]]
    pairs = np.concatenate([np.stack([a.reshape(-1), b.reshape(-1)], axis=1) for a, b in rows]).astype(np.int32)
    family = families_of(mesh.positions, mesh.triangles, pairs)
    assert [FAMILIES[k] for k in family] == ["bending along"] * 24 + ["bending across"] * 24


def test_springs_beside_the_mesh_are_others_and_strange_triangles_have_families():
    mesh = plane(2, 1.0)
    far = np.array([[0, 15], [0, 14], [3, 12]], np.int32)
    assert [FAMILIES[k] for k in families_of(mesh.positions, mesh.triangles, far)] == ["other"] * 3
    assert [FAMILIES[k] for k in families_of(mesh.positions, mesh.triangles[:0], far)] == ["other"] * 3
    assert len(families_of(mesh.positions, mesh.triangles, far[:0])) == 0
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, 1)], float)
    pairs = np.array([(0, 1), (1, 2), (3, 4), (2, 3)], np.int32)
    for strange in ([(0, 1, 2)], [(0, 0, 0)], [(0, 1, 2)] * 2, [(0, 1, 2), (0, 1, 3), (0, 1, 4)]):
        assert len(families_of(points, np.array(strange, np.int32), pairs)) == 4


def test_cells_that_are_cut_crosswise_have_the_directions_of_their_triangles():
    """A vertex in the middle of each cell: the half diagonals are the sides of right-angled cells."""
    n = 5
    x, z = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    cx, cz = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    points = np.column_stack([np.append(x, cx), np.zeros((n + 1) ** 2 + n * n), np.append(z, cz)])
    corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (part.reshape(-1) for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    m = (n + 1) ** 2 + np.arange(n * n)
    triangles = np.concatenate([np.stack(each, axis=1) for each in ((a, b, m), (b, c, m), (c, d, m), (d, a, m))])
    found = counts(Mesh(points, triangles.astype(np.int32)))
    assert {name: found[name] for name in ("edges along", "edges across", "edges diagonal")} == {
        "edges along": 2 * n * n, "edges across": 2 * n * n, "edges diagonal": 2 * n * (n + 1)
    }  # fmt: skip


# The fields `families`, `regions` and `warp` of an object: what they do to the groups, and what is refused.


GRID = cloth(4, 3)
SPRINGS = len(GRID["springStiffness"])
ZERO = [0] * SPRINGS


def groups(**fields):
    (own,) = load(document({**GRID, **fields})).cloths
    return spring_groups(own), vertex_groups(own)


def test_given_families_replace_those_of_the_mesh_and_empty_ones_are_left_out():
    given = {"names": ["yarn", "nothing", "fold"], "springs": [0, 2] + [0] * (SPRINGS - 2)}
    springs, vertices = groups(families=given, warp={"x": 1, "y": 0, "z": 0})
    assert sizes(springs) == {"yarn": SPRINGS - 1, "fold": 1}
    assert sizes(vertices) == {"all": 12}


@pytest.mark.parametrize(("warp", "along"), [((-3, 0, 0), 9), ((0, 0, -3), 8), ((0, 1, 0), 9)])
def test_the_warp_says_which_direction_of_a_grid_is_along(warp, along):
    """One across the cloth says nothing: x counts."""
    springs, _ = groups(warp=dict(zip("xyz", warp, strict=True)))
    assert sizes(springs)["edges along"] == along
    made = new_scene(plane(5, 1.0), bending=False).cloths[0]  # a warp along the diagonals of the cells is followed
    diagonal = np.broadcast_to([1.0, 0.0, 1.0], made.triangles.shape)
    assert np.bincount(families_of(made.positions, made.triangles, made.springs, diagonal)).tolist() == [36, 0, 84]


def test_a_spring_lies_in_the_first_region_with_both_its_ends_and_a_vertex_in_the_first_that_has_it():
    """Two columns of two cells each share a column of vertices; what lies in neither is elsewhere."""
    columns = [[4 * j + i for j in range(3)] for i in range(4)]
    left, right = columns[0] + columns[1], columns[1] + columns[2]
    springs, vertices = groups(regions=[{"name": "left", "vertices": left}, {"name": "right", "vertices": right}])
    assert sizes(vertices) == {"left": 6, "right": 3, "elsewhere": 3}
    assert sizes(springs) == {
        "edges along, left": 3, "edges along, right": 3, "edges along, elsewhere": 3,
        "edges across, left": 4, "edges across, right": 2, "edges across, elsewhere": 2,
        "edges diagonal, left": 2, "edges diagonal, right": 2, "edges diagonal, elsewhere": 2,
    }  # fmt: skip


def test_without_a_grid_the_angle_with_the_warp_decides():
    """The angles are those with a direction that is turned with the mesh; 22.5° and 67.5° are the borders."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.random((200, 2)), np.zeros(200)])
    triangles = Delaunay(points[:, :2]).simplices.astype(np.int32)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    made = new_scene(Mesh(points, triangles), bending=False).cloths[0]
    warp = np.broadcast_to(turn[0], triangles.shape)
    family = families_of(points @ turn, triangles, made.springs, warp)
    e = points[made.springs[:, 1]] - points[made.springs[:, 0]]
    angle = np.degrees(np.arctan2(np.abs(e[:, 1]), np.abs(e[:, 0])))
    assert (family == np.select([angle < 22.5, angle > 67.5], [0, 1], 2)).all()


@pytest.mark.parametrize(
    ("field", "value", "place", "word"),
    [
        ("families", {"names": ["a"], "springs": [0]}, "families.springs", f"1 value for {SPRINGS} springs"),
        ("families", {"names": ["a"], "springs": [*ZERO[1:], 1]}, f"families.springs[{SPRINGS - 1}]", "family 1 does"),
        ("families", {"names": ["a", "a"], "springs": ZERO}, "families.names[1]", '"a" is there already'),
        ("families", {"names": [" "], "springs": ZERO}, "families.names[0]", "is empty"),
        ("regions", [{"name": "a", "vertices": [0, 12]}], "regions[0].vertices[1]", "vertex 12 does not exist"),
        ("regions", [{"name": "a", "vertices": [10**30]}], "regions[0].vertices[0]", "does not exist"),
        ("regions", [{"name": "a", "vertices": [0]}] * 2, "regions[1].name", "there already"),
        ("regions", [{"name": "elsewhere", "vertices": [0]}], "regions[0].name", "in no region"),
        ("warp", {"x": 0, "y": 0, "z": 0}, "warp", "no length"),
    ],
)  # fmt: skip
def test_a_broken_field_gives_one_problem_with_its_place(field, value, place, word):
    (found,) = problems(changed(document(GRID), ("objects", 0, field), value))
    assert found.startswith(f"objects[0].{place}: ")
    assert word in found
