"""Which vertices of a moving mesh something holds: those of exact rigid motions, and no others."""

import numpy as np
from scipy.spatial.transform import Rotation

from clothfit import mesh
from clothfit.meshes.rigid import held, moves_as

SHEET = mesh.plane(8, 1.0)  # 10 × 10 vertices, the first row is 0 … 9
TIMES = np.linspace(0.0, 1.0, 20)


def waved():
    """Frames in which all vertices move, each in its own way, by 5 cm."""
    phase = np.random.default_rng(1).uniform(0, 6, SHEET.positions.shape)
    return SHEET.positions + 0.05 * (np.sin(phase + 5 * TIMES[:, None, None]) - np.sin(phase))


def swung(points):
    """Points that turn about an axis and move, rounded as in a file of single precision."""
    turns = Rotation.from_rotvec(TIMES[:, None] * [0.3, 0.2, -0.5]).as_matrix()
    there = np.einsum("fij,nj->fni", turns, points) + TIMES[:, None, None] ** 2 * [0.1, 0.0, 0.2]
    return there.astype(np.float32).astype(float)


def test_a_row_that_turns_and_a_patch_inside_are_found_each_as_one_body():
    frames, row, patch = waved(), np.arange(10), np.array([44, 45, 54, 55, 56, 65])
    frames[:, row], frames[:, patch] = swung(SHEET.positions[row]), SHEET.positions[patch]
    found = held(frames, SHEET.triangles)
    assert [(each.vertices.tolist(), each.moves) for each in found] == [(patch.tolist(), False), (row.tolist(), True)]


def test_corners_that_move_alike_are_one_body_and_free_vertices_none():
    frames, corners = waved(), [0, 9]
    assert held(frames, SHEET.triangles) == []
    frames[:, corners] = SHEET.positions[corners] + np.sin(TIMES)[:, None, None] * [0.0, 0.2, 0.1]
    assert [(each.vertices.tolist(), each.moves) for each in held(frames, SHEET.triangles)] == [(corners, True)]


def test_a_row_that_is_drawn_into_pleats_is_one_group():
    frames, row = waved(), np.arange(10)
    there = np.stack([-0.5 * row / 9, 0.0 * row, 0.06 * np.sin(row)], axis=1)  # a shape key's: each on a line
    frames[:, row] = SHEET.positions[row] + np.sin(2 * TIMES)[:, None, None] * there
    (still, drawn) = held(frames.astype(np.float32).astype(float), SHEET.triangles)
    assert (still.vertices.tolist(), drawn.vertices.tolist()) == ([0], row[1:].tolist())


def test_a_mesh_that_moves_as_a_whole_is_rigid_and_not_held():
    whole = swung(SHEET.positions)
    assert (moves_as(whole), held(whole, SHEET.triangles)) == ("rigid", [])
    assert moves_as(np.repeat(SHEET.positions[None], 20, axis=0)) == "still"
    assert moves_as(whole * np.linspace(1.0, 1.01, 20)[:, None, None]) == "moves"  # it grows by 1 %
