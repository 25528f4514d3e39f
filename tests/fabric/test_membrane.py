"""Stretch and shear of springs per width, against closed forms of lattices, and springs for a given stretch."""

import numpy as np
import pytest
from helpers.lattices import square, triangular

from clothfit.fabric import membrane
from clothfit.fabric.hinges import edge_squares, material

ROUNDING = 1e-9
GROUNDED = 1e-5  # what holds the whole in place is 1e-9 of a spring, times the square of the cells across


def grid(k, shear, cells=8):
    """A grid with springs k, N/m, along its cells, halved at the border, and `shear` over one diagonal of each."""
    mesh = material(*square(cells))
    border = np.where(mesh.uses == 1, 0.5, 1.0)
    return mesh, np.where(mesh.diagonal, shear, k * border)


def uniform(mesh, stiffness):
    """C of a mesh by its edges."""
    e = mesh.positions[mesh.ends[:, 0]] - mesh.positions[mesh.ends[:, 1]]
    return membrane.tensor(edge_squares(mesh), stiffness * (e * e).sum(axis=1), mesh.area)


def test_a_grid_without_diagonals_stretches_as_its_springs_and_does_not_resist_shear():
    mesh, k = grid(70.0, 0.0)
    assert uniform(mesh, k) == pytest.approx(np.diag([70.0, 70.0, 0.0]), abs=70 * ROUNDING)
    assert membrane.pulls(uniform(mesh, k)) == pytest.approx([70.0, 70.0, 0.0], rel=ROUNDING)
    assert membrane.measured(mesh, mesh.ends, k) == pytest.approx([70.0, 70.0, 0.0, 0.0], rel=GROUNDED)


def test_one_diagonal_adds_a_quarter_of_its_stiffness_times_two_to_each_component():
    """k L² d⁴ / A with L² = 2 h², d = (1, 1)/√2 and A = h²: k/2 for each. A pull along the warp is the warp's alone, as
    stress is a sum of those of three directions in one way only; a unit shear is one of the diagonals, less one of warp
    and one of weft, and its compliance 1/k + 1/k + 1/(k/2).
    """
    mesh, k = grid(70.0, 60.0)
    assert np.abs(uniform(mesh, k)) == pytest.approx(np.diag([70.0, 70.0, 0.0]) + 30.0, rel=ROUNDING)
    found = membrane.measured(mesh, mesh.ends, k)
    assert found[:2] == pytest.approx([70.0, 70.0], rel=GROUNDED)
    assert found[3] == pytest.approx(1 / (1 / 70 + 1 / 70 + 1 / 30), rel=GROUNDED)


def test_a_triangular_lattice_is_isotropic_with_a_poisson_ratio_of_a_third():
    """E = 2 k/√3 and ν = 1/3 of equal springs; each bears the area at it, so those of the border are half as stiff."""
    mesh = material(*triangular(7, 9, 0.3))
    found = uniform(mesh, np.where(mesh.uses == 1, 0.5, 1.0) * 50.0)
    modulus = 100 / np.sqrt(3)
    assert membrane.pulls(found) == pytest.approx(np.full(3, modulus), rel=ROUNDING)
    assert found[0, 1] / found[0, 0] == pytest.approx(1 / 3)  # ν of a plane stress: C₁₁₂₂/C₁₁₁₁
    assert found[2, 2] == pytest.approx(modulus / (2 * (1 + 1 / 3)))
    assert membrane.measured(mesh, mesh.ends, np.where(mesh.uses == 1, 25.0, 50.0)) == pytest.approx(
        [*np.full(3, modulus), 0.375 * modulus], rel=GROUNDED
    )


def test_values_of_a_cloth_do_not_depend_on_how_it_is_turned_or_folded_over_a_roll():
    positions, faces = square(12)
    roll = np.stack([np.sin(positions[:, 0]), np.cos(positions[:, 0]), positions[:, 2]], axis=1)  # radius 1 m
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    flat, turned = material(positions, faces), material(positions @ turn.T, faces, turn[:, 0])
    k = np.random.default_rng(2).uniform(10, 20, len(flat.ends))
    plain = membrane.measured(flat, flat.ends, k)
    assert membrane.measured(turned, turned.ends, k) == pytest.approx(plain, rel=GROUNDED)
    rolled = membrane.measured(material(roll, faces), flat.ends, k)
    assert rolled == pytest.approx(plain, rel=0.03)  # triangles are 1/24 rad out of the tangent planes


@pytest.mark.parametrize("stretch", [(100.0, 80.0, 70.0), (2000.0, 400.0, 180.0)])
def test_the_wanted_stiffness_has_the_wanted_pulls(stretch):
    assert membrane.pulls(membrane.wanted(np.array(stretch))) == pytest.approx(stretch, rel=1e-6)


def test_the_plain_rule_is_exact_in_a_lattice_of_equilateral_triangles():
    mesh = material(*triangular(9, 9))
    found = membrane.springs_for(mesh, membrane.wanted(np.full(3, 40.0)))
    inner = mesh.uses == 2
    error = found[inner] / (40 * np.sqrt(0.75)) - 1
    assert np.abs(np.median(error)) < 1e-3
    assert np.abs(error).max() < 0.1  # at its corners, which have the mass of one or two triangles, not of three
