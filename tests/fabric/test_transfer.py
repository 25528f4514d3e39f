"""A fabric on another mesh: the same values per area, local differences, directions, damping and air."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from helpers.fabrics import scene
from helpers.lattices import square

from clothfit import InvalidInput, load, new_scene, save
from clothfit.cli.program import group
from clothfit.fabric.fabric import fabric_of
from clothfit.fabric.transfer import transferred
from clothfit.meshes.mesh import Mesh, plane


def on(target, source):
    """The target with the fabric of the source."""
    document = json.loads(target.source.text)
    document["objects"][0] |= transferred(source.cloths[0], target.cloths[0]).fields
    return load(document).cloths[0]


def editors(divisions, **more):
    return new_scene(Mesh(*plane(divisions, 1.0)[:2]), **more)


@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_a_fabric_that_resists_bending_does_so_on_another_mesh(jitter):
    source = scene(square(9), stretch=(300.0, 200.0, 180.0), bend=(2e-4, 1e-4, 1.2e-4))
    found, own = fabric_of(on(editors(14), source)), fabric_of(source.cloths[0])
    irregular = new_scene(Mesh(*square(14, jitter=jitter)))
    for each in (found, fabric_of(on(irregular, source))):
        assert each.density == pytest.approx(own.density)
        assert each.stretch[:2] == pytest.approx(own.stretch[:2], rel=0.01)
        assert each.bending_at_rest == pytest.approx(own.bending_at_rest, rel=0.01)


def test_a_plane_of_the_editor_becomes_the_one_that_the_editor_makes_of_the_finer_mesh():
    """Its springs are those of E and of a quarter of it, on whatever grid: within the least squares' 1 %."""
    coarse, fine = editors(7, stiffness=80.0, density=0.3), editors(15, stiffness=80.0, density=0.3)
    found, known = on(fine, coarse), fine.cloths[0]
    order, other = (np.lexsort(np.sort(each.springs, axis=1).T) for each in (found, known))
    assert np.array_equal(np.sort(found.springs, axis=1)[order], np.sort(known.springs, axis=1)[other])
    inner = known.stiffness[other] > 15  # those of the border share what they bear with their neighbours
    ratio = found.stiffness[order] / known.stiffness[other]
    assert np.median(ratio[inner]) == pytest.approx(1, rel=0.01)
    assert found.mass == pytest.approx(known.mass)
    assert fabric_of(found).stretch == pytest.approx(fabric_of(known).stretch, rel=0.01)


def test_local_differences_go_along_where_the_meshes_lie_in_one_place():
    coarse = editors(8)
    own = coarse.cloths[0]
    x = own.positions[:, 0]
    stiff = np.where(own.positions[own.springs, 0].mean(axis=1) > 0, 3.0, 1.0)
    uneven = replace(coarse, cloths=(replace(own, stiffness=own.stiffness * stiff, mass=own.mass * np.exp(x)),))
    fine = editors(14)
    plain, found = on(fine, coarse), on(fine, uneven)
    side = plain.positions[plain.springs, 0].mean(axis=1)
    ratio = found.stiffness / plain.stiffness
    right, left = np.median(ratio[side > 0.2]), np.median(ratio[side < -0.2])
    assert right / left == pytest.approx(3, rel=0.05)
    mass = found.mass / plain.mass
    assert np.corrcoef(np.log(mass), found.positions[:, 0])[0, 1] > 0.99
    away = new_scene(Mesh(plane(14, 1.0).positions + [5, 0, 0], plane(14, 1.0).triangles))
    assert not transferred(uneven.cloths[0], away.cloths[0]).local


def test_the_air_stays_the_same():
    """In the editor's law ϱ/(8 A²) is the drag of air of 1 m/s: faces of a quarter of the area need 16 times that."""
    coarse, fine = editors(3, drag=0.1, damping=0.7), editors(7)
    found = on(fine, coarse)
    assert found.drag == pytest.approx(1.6)
    assert found.damping == 0.7


def test_the_command_writes_a_scene_and_refuses_what_does_not_fit(tmp_path):
    save(scene(square(6)), tmp_path / "a.json")
    save(editors(9), tmp_path / "b.json")
    run = CliRunner().invoke
    done = run(group, ["transfer", str(tmp_path / "a.json"), str(tmp_path / "b.json"), "--json"])
    assert done.exit_code == 0, done.output
    made = load(tmp_path / "b.transferred.json")
    assert made.newton_iterations == 2
    assert fabric_of(made.cloths[0]).bending_at_rest == pytest.approx([1e-4] * 3, rel=0.01)
    over = run(group, ["transfer", str(tmp_path / "a.json"), str(tmp_path / "b.json"), "-o", str(tmp_path / "a.json")])
    assert isinstance(over.exception, InvalidInput)  # an input is never written over
