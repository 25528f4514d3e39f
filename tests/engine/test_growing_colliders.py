"""Colliders whose size changes over time: what they push, what friction feels of it, derivatives, and what is refused.
"""

import numpy as np
import pytest
from helpers.derivatives import assert_derivatives
from helpers.physics import METHODS, ball, keys, scene, sheet, thing, xyz
from helpers.surfaces import block, body

from clothfit.base.errors import InvalidScene
from clothfit.engine.forces import colliders, touch
from clothfit.engine.inputs.sampling import states
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.system import build
from clothfit.motion.simulate import simulate
from clothfit.pictures.solids import solids

TIGHT = 1e-13


def shape(kind, lengths=(1, 1, 1), at=(0, 0, 0), **fields):
    """A collider of a type of the file."""
    return {**body(block()), "type": kind, "pos": xyz(at), "scale": xyz(lengths), **fields}


GROWS = keys([0, 0.04, 0.1], [(2, 2, 2), (2.6, 2.4, 2.2), (2.2, 3, 2.6)])
DROP = {"delta": 0.005, "optimizationIterations": 41, "tolerance": TIGHT}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "interpolation"),
    # a mesh that jumps throws the vertex off, and then meets it earlier in a step than a box does
    [(3, "linear"), (3, "smooth"), (3, "hold"), (4, "linear"), (4, "smooth")],
)
def test_a_vertex_on_a_box_that_grows_is_one_on_a_box_that_is_lifted(kind, interpolation):
    one = thing([(0.1, 0.5, 0.05)], mass=0.05, vertVel=[xyz((0, 0, 0))])
    grows = {**GROWS, "interpolation": interpolation}
    top = [0.5 * (value["y"] / 2 - 1) for value in GROWS["values"]]
    lifted = keys(GROWS["times"], [(0, y, 0) for y in top], interpolation=interpolation)
    wide = shape(3, (4, 1, 4), posKeys=lifted, stiffness=100)
    a = simulate(scene(one, colliders=[shape(kind, scaleKeys=grows, stiffness=100)], **DROP))
    b = simulate(scene(one, colliders=[wide], **DROP))
    assert np.ptp(a.positions[:, 0, 1]) > 0.05
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-11)


@pytest.mark.slow
def test_a_ball_that_grows_is_an_ellipse_of_none_and_the_same_for_capsules_without_height():
    one = thing([(0.2, 0.5, 0.1)], mass=0.05)
    balls = [shape(1, scaleKeys=GROWS), shape(2, (1, 0.5, 1), scaleKeys=GROWS, friction=0.0)]
    a, b = (simulate(scene(one, colliders=[each], **DROP)) for each in balls)
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", [2, 3])  # a ball moves its points along its normals
def test_its_surface_has_the_velocity_of_its_points(kind, method):
    # what is at p in the axes is at f p there: of a capsule in the radial directions by x, along its axis by y
    turned = {"rot": xyz((20, 30, 40)), "scaleKeys": GROWS, "thickness": 10.0, "friction": 0.3}
    one = thing([(0.4, 0.3, -0.2)])
    made = scene(one, colliders=[shape(kind, **turned)], integrationMethod=METHODS[method], **DROP)
    system, h = build(made, 0), made.delta
    which = {2: [0, 1, 0], 3: [0, 1, 2]}[kind]
    values = np.array([[value[axis] for axis in "xyz"] for value in GROWS["values"]])[:, which]
    axes = states(made.colliders, np.zeros(1), h, 0)[0, 0, touch.AXES : touch.SIZE]
    for t in (0, 5, 9, 15):
        set_inputs(system.inputs, system, t)
        begins, now, ends = (
            np.array([np.interp(h * (t + k), GROWS["times"], column) for column in values.T])
            for k in (0, system.inputs.lead, 1)
        )
        p = axes @ system.x0[0]
        expected = axes.T @ (p * (ends - begins) / (h * now))
        depth, normal = touch.depths(system.colliders, system.x0)
        along, still = np.zeros((1, 3)), np.zeros((1, 3))
        colliders.add_force(system.colliders, system.x0, expected[None], along)  # which does not slide
        colliders.add_force(system.colliders, system.x0, np.zeros((1, 3)), still)
        np.testing.assert_allclose(along[0], 1000.0 * depth[0, 0] * normal[0, 0], rtol=1e-10, atol=1e-9)
        assert np.abs(still - along).max() > 1.0


def growing(method, newton, settings="LL"):
    """A cloth in friction with shapes that grow, turn and go."""
    law = {"friction": 0.4, "thickness": 0.12, "stiffness": 40, "scaleKeys": GROWS}
    goes = {"posKeys": keys([0, 0.1], [(0, 0, 0), (0.05, 0, 0.02)]), "rotKeys": keys([0, 0.1], [(0, 0, 0), (9, 5, 2)])}
    made = [
        {**ball((1.0, -0.75, 1.0), 0.75), **law, **goes},
        shape(2, (0.3, 0.5, 0.3), (0.0, -0.25, 1.0), rot=xyz((0, 0, 80)), **law),
        shape(3, (0.5, 0.4, 0.5), (2.0, -0.25, 1.1), rot=xyz((5, 3, 0)), **law),
        shape(4, (0.5, 0.4, 0.5), (1.0, -0.25, 2.0), rot=xyz((3, 5, 0)), **law),
    ]
    return scene(
        sheet(settings, damping=0.3), colliders=made, integrationMethod=METHODS[method], forwardSubSteps=newton,
        delta=0.01, optimizationIterations=7, tolerance=1e-15,
        fit={"friction": "L", "contact": "L", "colliderOffset": "G"},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton"), [("symplectic", 1), ("implicit", 3), ("bdf2", 1)])
def test_gradient_tangent_and_columns(method, newton):
    assert_derivatives(growing(method, newton), 1e-15, 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_pictures_show_its_size(kind):
    made = scene(thing([(0.1, 0.6, 0)]), colliders=[shape(kind, (1, 0.8, 1), scaleKeys=GROWS)], **DROP)
    (found,) = solids(made, np.array([0.0, 0.04, 0.1]), made.cloths[0].positions[None])
    assert found.moves
    sizes = np.array([np.ptp(found.at(frame), axis=0) for frame in range(3)])
    along_x = np.array([1.0, 1.3, 1.1])
    np.testing.assert_allclose(sizes[:, 0], along_x * sizes[0, 0], rtol=1e-12)
    assert sizes[0, 0] == pytest.approx(1.0, rel=1e-2)


def test_a_smooth_scale_that_swings_below_0_is_refused_with_its_place(tmp_path):
    swing = keys([0, 0.02, 0.04, 0.06], [(5, 5, 5), (0.01, 0.01, 0.01), (0.01, 0.01, 0.01), (5, 5, 5)])
    (tmp_path / "zero.csv").write_text("0,1,1,1\n1,1,1,0\n")
    zero = {"file": str(tmp_path / "zero.csv")}
    for own, kind in (({**swing, "interpolation": "smooth"}, 3), ({**swing, "interpolation": "smooth"}, 4), (zero, 1)):
        made = scene(thing([(0, 0, 0)]), colliders=[shape(kind, scaleKeys=own)], delta=0.005)
        with pytest.raises(InvalidScene, match=r"colliders\[0\]\.scaleKeys.*: at .* s the scale is not above 0"):
            build(made, 0, steps=300)


def test_a_plane_has_no_size():
    made = scene(thing([(0, 0, 0)]), colliders=[shape(0, scaleKeys=GROWS)], planes="solid")
    assert made.warnings == ("colliders[0].scaleKeys: a plane has no size, so they change nothing",)
    assert not made.moves
