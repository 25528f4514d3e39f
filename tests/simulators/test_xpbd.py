"""The step of XPBD: closed forms, its derivatives, and what it moves as when it is converged."""

from dataclasses import replace

import numpy as np
import pytest

from clothfit import InvalidInput, new_scene
from clothfit.evaluation.reference import converged
from clothfit.export.blender import FOLD
from clothfit.meshes.mesh import plane
from clothfit.scene.keys import Keys, Pin
from clothfit.simulators import directions, xpbd
from clothfit.simulators.substep import bend, measure

pytestmark = pytest.mark.slow  # compiles

FRAMES = 9
FOLDED = np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.0], [0.1, 0.7, 0.2], [0.2, -0.5, 0.3]])
HINGE = np.array([[0, 1, 2, 3]], np.int32)


def sheet(divisions=2, sphere=True, pinned=True):
    """A sheet held at two vertices, one of which moves, in wind and over a sphere."""
    mesh = plane(divisions, 1.0)
    held = np.zeros(len(mesh.positions), bool)
    held[[0, 2]] = True
    ball = [(0.1, -0.25, 0.1, 0.3)] if sphere else []
    made = new_scene(
        mesh, held, density=0.2, stiffness=30.0, damping=0.1, drag=40.0, frames=FRAMES, delta=0.02,
        wind=(1.0, 0.0, 2.0), spheres=ball,
    )  # fmt: skip
    (own,) = made.cloths
    rng = np.random.default_rng(1)
    own = replace(own, velocity=0.3 * rng.normal(size=own.positions.shape), pins=(PIN,) if pinned else ())
    return replace(made, cloths=(own,))


KEYS = Keys(np.array([0.0, 0.08, 0.16]), np.array([[0.0, 0, 0], [0, 0.06, 0.02], [0, 0, 0]]), "linear")
PIN = Pin(np.array([0], np.int32), KEYS, None, None)
"""The first vertex goes 6 cm up and back."""


def moved(model, change, step):
    """The model with other values, by a change of their logarithms, field by field."""
    own = {name: getattr(model, name) * np.exp(step * change[name]) for name in change if name != "drag"}
    own["inverse"] = model.inverse * np.exp(-step * change["inverse"])
    drag = model.faces.drag * float(np.exp(step * np.sum(change["drag"])))
    return model._replace(**own, faces=model.faces._replace(drag=drag))


@pytest.mark.parametrize("members", [np.array([[0, 2, -1, -1]], np.int32), HINGE])
def test_a_constraints_derivatives_are_those_of_its_value(members):
    rest, (g, up, down, out, own), h = np.zeros(1), np.zeros((5, 4, 3)), 1e-6
    d, used = np.random.default_rng(0).normal(size=(4, 3)), members[0][members[0] >= 0]
    own[used] = d[: len(used)]
    measure(members, rest, 0, FOLDED, g)
    above, below = (measure(members, rest, 0, FOLDED + s * h * own, each) for s, each in ((1, up), (-1, down)))
    # central differences: h² and rounding over h, both below 1e-9
    assert (above - below) / (2 * h) == pytest.approx((g * d)[: len(used)].sum(), rel=1e-7)
    bend(members, 0, FOLDED, d, out)
    assert np.allclose(((up - down) / (2 * h))[: len(used)], out[: len(used)], atol=1e-7)


def test_an_angle_is_that_between_the_faces():
    g = np.zeros((4, 3))
    for theta in (-2.5, -0.3, 0.0, 1.0, 3.0):
        x = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 1, 0], [0.6, -np.cos(theta), np.sin(theta)]])
        found = measure(HINGE, np.zeros(1), 0, x, g)
        assert abs(found) == pytest.approx(abs(theta), abs=1e-14)
        # the torque about the hinge of the vertex across it, at a distance of 1, is that of the angle
        assert np.linalg.norm(g[2]) == pytest.approx(1.0, rel=1e-14)
        assert np.abs(g.sum(axis=0)).max() < 1e-14
        assert np.abs(np.cross(x, g).sum(axis=0)).max() < 1e-14


@pytest.mark.parametrize("bending", xpbd.BENDING)
def test_the_changes_along_all_directions_are_those_of_the_motion(bending):
    """In wind, over a sphere, with a pin that moves; each kind of values by itself, with a lane of each value; the air
    by the law "air" where bending is by angles.
    """
    model = xpbd.model_of(sheet(), 0, xpbd.Settings(3, 2, bending), FRAMES)
    if bending == "angle":
        model = model._replace(faces=model.faces._replace(quadratic=True, drag=np.array([1.2])))
    model = model._replace(relaxation=np.linspace(0.6, 1.6, len(model.rest)))  # below and above 1
    x, _ = directions.simulate(model, FRAMES)
    assert (np.linalg.norm(x - model.centre[0, 0], axis=2) < model.radius[0]).any()  # it touches
    path = np.interp(0.02 * np.arange(FRAMES), KEYS.times, KEYS.values[:, 1])
    assert np.abs(x[:, 0, 1] - x[0, 0, 1] - path).max() < 1e-15  # the pin goes its way
    assert not np.ptp(x[:, 2], axis=0).any()  # held, and no pin
    some = {"inverse": model.free, "damping": model.free, "drag": np.ones(1, bool)}
    names = "compliance", "time", "rest", "inverse", "damping", "relaxation", "drag"
    chosen = [some.get(name, np.ones(len(model.rest), bool)) for name in names]
    ends = np.cumsum([0, *map(np.sum, chosen)])
    lanes = (np.where(own, end + np.cumsum(own) - 1, -1) for own, end in zip(chosen, ends[:-1], strict=True))
    seeds = directions.Seeds(*(lane.astype(np.int32) for lane in lanes))
    sweep = directions.Sweep(model, seeds, int(ends[-1]))
    for t in range(FRAMES - 1):
        sweep.advance(t)
    assert (sweep.x == x[-1]).all()
    d, e = np.random.default_rng(3).normal(size=ends[-1]), 1e-5
    for k, (name, start, end) in enumerate(zip(names, ends[:-1], ends[1:], strict=True)):
        change = dict.fromkeys(names, 0.0) | {name: np.zeros(len(chosen[k]))}
        change[name][chosen[k]] = d[start:end]
        up, down = (directions.simulate(moved(model, change, s * e), FRAMES)[0][-1] for s in (1, -1))
        wanted = (up - down) / (2 * e)
        # the error of central differences is of order e², and rounding
        assert np.abs(sweep.dx[..., start:end] @ d[start:end] - wanted).max() < 1e-6 * np.abs(wanted).max()
        assert wanted.any()


def test_relaxed_iterations_end_at_the_same_place_sooner():
    """Over-relaxation of Gauss–Seidel comes nearer in as many sweeps. The equations are linear here: the motion is so
    small that the directions of constraints stay, on which the order of corrections has an influence.
    """
    scene = sheet(4, sphere=False, pinned=False)
    (own,) = scene.cloths
    own = replace(own, velocity=1e-6 * own.velocity, stiffness=30.0 * own.stiffness)
    scene = replace(scene, cloths=(own,), gravity=np.zeros(3), wind=np.zeros(3))

    def moved_by(iterations, omega):
        model = xpbd.model_of(scene, 0, xpbd.Settings(1, iterations), 2)
        return directions.simulate(model._replace(relaxation=np.full(len(model.rest), omega)), 2)[0][1]

    end = moved_by(5000, 1.0)
    plain, over, far = (np.abs(moved_by(*how) - end).max() for how in ((60, 1.0), (60, 1.3), (5000, 1.5)))
    assert far < 1e-13  # of ways of 1e-8 m: what is not linear is of order 1e-16, and rounding
    assert over < 0.7 * plain


@pytest.mark.parametrize("sphere", [False, True])
def test_converged_it_moves_as_the_springs_do(sphere):
    """With compliances 1/k and short steps: the motion of the equations."""
    scene = sheet(sphere=sphere, pinned=False)
    truth = converged(scene, FRAMES).positions
    size = np.abs(truth - truth[0]).max()
    coarse, fine = (
        directions.simulate(xpbd.model_of(scene, 0, xpbd.Settings(substeps, 8), FRAMES), FRAMES)[0]
        for substeps in (100, 200)
    )
    error, half, limit = (np.abs(found - truth).max() / size for found in (coarse, fine, 2 * fine - coarse))
    assert error / half == pytest.approx(2.0, rel=0.1)  # of first order: with h to 0 the motion is that one
    assert limit < 1e-3
    assert half < (0.03 if sphere else 1e-3)  # a contact of 1000 N/m swings ten times as fast as the springs


def test_bending_by_angles_is_as_strong_as_the_spring_at_the_angle_of_the_mapping():
    scene = sheet(3, sphere=False)
    (own,) = scene.cloths
    by_angle = xpbd.model_of(scene, 0, xpbd.Settings(1, 1, "angle"), 2)
    bent = by_angle.members[:, 2] >= 0
    assert bent.sum() > 0
    torque = FOLD / by_angle.compliance[bent]
    assert torque == pytest.approx(own.stiffness[bent] * own.rest[bent] ** 2 * FOLD**3 / 32, rel=1e-12)
    assert np.abs(by_angle.rest[bent]).max() < 1e-12  # of a flat sheet


def test_what_xpbd_has_not_is_refused():
    with pytest.raises(InvalidInput, match="there is no 'crease'"):
        xpbd.model_of(sheet(), 0, xpbd.Settings(1, 1, "crease"), 2)
