"""The accounts of energy: closed forms, the very forces of the steps, and what each integrator does to the total."""

import numpy as np
import pytest
from helpers.obstacles import box, capsule, plane
from helpers.physics import GRAVITY, METHODS, STATES, ball, full, keys, of_air, scene, sheet, state, thing, unbound, xyz
from helpers.scenes import cloth

import clothfit.motion.energy
from clothfit import Energy, InvalidInput, InvalidMotion, Motion, degrade, energies, simulate
from clothfit.cli.common.console import Console
from clothfit.cli.simulate import joules, show_energy
from clothfit.engine.forces import springs, total, vertex, wind
from clothfit.engine.rollout import rollout
from clothfit.engine.step.states import velocity
from clothfit.engine.system import all_elements, build, with_elements

SMOOTH = {"interpolation": "smooth"}
def force(system, y, u):
    f = np.zeros_like(y)
    total.add_force(system, y, u, f)
    return f


def account(made, frames, **options):
    return energies(made, simulate(made, frames, tolerance=1e-13, **options))


# --- the forces that the steps use


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize("law", [lambda system: system, of_air])
def test_what_is_not_potential_is_wind_damping_and_drag(name, law):
    system = law(full())
    at = state(system, name)
    still = with_elements(system, all_elements(system)._replace(wind=np.zeros(3)))
    conservative = np.vdot(force(still, at.y, np.zeros_like(at.y)), at.w)
    blown, dragged = wind.powers(system.faces, at.y, at.u, at.w)
    damped = vertex.damping_power(system.vertex, at.y, at.u, at.w)
    damped += springs.damping_power(system.springs, at.y, at.u, at.w)
    f = force(system, at.y, at.u)
    assert abs(conservative + blown + dragged + damped - np.vdot(f, at.w)) < 1e-12 * np.abs(f * at.w).sum()


# --- closed forms


def test_a_stretched_spring_and_a_vertex_in_a_sphere_hold_half_their_stiffness_times_length_squared():
    pair = thing([(0, 0, 0), (1.5, 0, 0), (0, 3, 0)], [(0, 1), (1, 2)], stiffness=[8.0, 2.0], fixed=(0, 1, 2))
    pair["springRestLength"] = [1.0, 4.0]
    found = account(scene(pair), 3)
    expected = 0.5 * 8.0 * 0.5**2 + 0.5 * 2.0 * (np.hypot(1.5, 3.0) - 4.0) ** 2
    np.testing.assert_allclose(found.elastic, expected, rtol=1e-14)
    np.testing.assert_array_equal(found.total, found.elastic)
    assert np.abs(found.dissipated).max() == 0.0
    one = thing([(0, 0.9, 0), (0, 2, 0)], fixed=(0, 1))
    found = account(scene(one, colliders=[ball((0, 0, 0), 1.0)]), 2)
    np.testing.assert_allclose(found.contact, 0.5 * 1000.0 * 0.1**2, rtol=1e-13)


@pytest.mark.parametrize(("method", "sign"), [("explicit", 1), ("symplectic", -1), ("implicit", -1)])
def test_free_fall_gains_or_loses_half_m_g_h_squared_a_step(method, sign):
    # v_k = −g h k; y_k = −g h² k (k ∓ 1)/2: kinetic and potential energy differ by ± ½ m g² h² k
    h, m, k = 0.01, 0.3, np.arange(51)
    drop = scene(thing([(0, 5, 0)], mass=m), integrationMethod=METHODS[method], delta=h)
    found = account(drop, len(k))
    fallen = 0.5 * GRAVITY * h**2 * k * (k - sign)
    np.testing.assert_allclose(found.kinetic, 0.5 * m * (GRAVITY * h * k) ** 2, atol=1e-12)
    np.testing.assert_allclose(found.gravity, -m * GRAVITY * fallen, atol=1e-12)
    np.testing.assert_allclose(found.total, sign * 0.5 * m * (GRAVITY * h) ** 2 * k, atol=1e-12)
    np.testing.assert_allclose(found.numerical, -found.total, atol=1e-12)


LIFT = {"posKeys": keys([0, 0.1, 0.3], [(0, 0, 0), (0, 0.01, 0), (0, 0.08, 0)])}
TOPS = {
    "sphere": {**ball((0, 0, 0), 0.3), **LIFT}, "ball": {**ball((0, 0, 0), 0.3), "stiffness": 900.0, **LIFT},
    "plane": {**plane((0, 0.3, 0)), **LIFT}, "box": {**box((0, 0, 0), (0.2, 0.6, 0.2)), **LIFT},
}  # fmt: skip


@pytest.mark.parametrize("top", TOPS)
def test_a_linear_step_loses_the_squares_of_the_changes_of_all_that_is_linear(top):
    """On a line all forces are linear, so that nothing but ½ m (Δw)², ½ κ (Δd)² and ½ k (ΔL)² is lost: pins, what
    lifts the vertex and a weight that changes do the rest.
    """
    h, m, k = 0.01, 0.2, 30.0
    two = thing([(0, 1.3, 0), (0, 0.298, 0)], [(0, 1)], mass=m, stiffness=k, fixed=(0,), damping=0.4)
    two["pins"] = [{"vertices": [0], "posKeys": keys([0, 0.15, 0.3], [(0, 0, 0), (0, 0.03, 0), (0, 0.06, 0)])}]
    heavier = keys([0, 0.3], [(0, 0, 0), (0, -5, 0)])
    made = scene(two, colliders=[TOPS[top]], planes="solid", delta=h, gravityKeys=heavier)
    motion = simulate(made, 31, tolerance=1e-14)
    found, system = energies(made, motion), build(made, 0, steps=30)
    y = motion.positions[:, :, 1]
    v = np.diff(y, axis=0, prepend=y[:1] - h * system.v0[:, 1]) / h
    kappa = 900.0 if top == "ball" else 1000.0
    assert (found.contact > 0).all()  # so it is touched all the time
    lost = 0.5 * m * (np.diff(v, axis=0) ** 2).sum(axis=1) + 0.5 * k * np.diff(y[:, 0] - y[:, 1]) ** 2
    lost += 0.5 * kappa * np.diff(np.sqrt(2 * found.contact / kappa)) ** 2
    assert found.moved[-1] > 0.1  # J
    np.testing.assert_allclose(np.diff(found.numerical), lost, atol=1e-13)
    assert found.excess == 0.0


@pytest.mark.parametrize(("method", "newton", "order"), [
    ("explicit", 1, 1), ("symplectic", 1, 1), ("implicit", 1, 1), ("implicit", 8, 1), ("bdf2", 1, 2),
])  # fmt: skip
def test_what_no_force_takes_is_of_the_order_of_the_steps(method, newton, order):
    """So work and damping are counted right, whatever the integrator: the rest must go with h, or h²."""
    left, taken = [], []
    for k in (2, 4, 8):
        fields = {"integrationMethod": METHODS[method], "forwardSubSteps": newton, "delta": 0.002 / k}
        led = {"vertices": [0], "posKeys": keys([0, 0.1, 0.2], [(0, 0, 0), (0.1, 0, 0.1), (0.1, 0.2, 0)], **SMOOTH)}
        own = sheet(dragCoefficient=3.0, pins=[led])
        found = account(scene(own, windVel=xyz((5, 3, -4)), **fields), 100 * k + 1)
        left.append(found.numerical[-1])
        taken.append([found.wind[-1], found.damping[-1], found.drag[-1], found.moved[-1]])
    # but for terms of the next order, and of BDF2 those of the one Euler step
    np.testing.assert_allclose(np.array(left[:2]) / left[1:], 2.0**order, atol=0.3 if order == 1 else 1.0)
    np.testing.assert_allclose(taken[1], taken[2], rtol=0.1)
    assert np.abs(taken[2]).min() > 3 * abs(left[2])  # so one of them left out would show


def test_the_velocities_of_bdf2_steps_are_those_that_it_took():
    system = build(scene(sheet(), integrationMethod=METHODS["bdf2"], delta=0.002), 0)
    memory, good = rollout(system, 12, 1e-13)
    assert (good, memory.euler.sum()) == (12, 1)
    found = clothfit.motion.energy.velocities(system, memory.x, 0, 13, np.append(False, memory.euler))
    taken = [velocity(memory, t) for t in range(13)]
    np.testing.assert_allclose(found, taken, atol=1e-11)  # rounding of positions of 1 m, over steps of 2 ms


# --- what the integrators do


@pytest.mark.parametrize("method", ["implicit", "bdf2"])
@pytest.mark.parametrize("shape", [
    ball((0, 0, 0), 0.3), plane(), box(lengths=(0.5, 0.4, 0.5)), capsule(radius=0.15, radius2=0.15, height=0.5),
])  # fmt: skip
def test_a_stiff_sheet_that_falls_on_something_gains_no_energy(shape, method):
    n, top = 13, {0: 0.0, 1: 0.3, 2: 0.4, 3: 0.2}[shape["type"]] + 0.01
    own = cloth(n, n, 1 / 15, damping=0.0, dragCoefficient=0.0, vertMass=[7.6e-4] * n * n)
    own |= {"vertIsFixed": [False] * n * n, "springStiffness": [1000.0] * len(own["springStiffness"])}
    own["vertPos"] = [xyz((p["x"] - 0.39, top + 0.5, p["z"] - 0.39)) for p in own["vertPos"]]
    solid = {**shape, "thickness": 0.01, "friction": 0.3}
    found = account(scene(own, colliders=[solid], planes="solid", delta=0.01, integrationMethod=METHODS[method]), 61)
    assert found.contact.max() > 0.0
    assert found.excess <= 0.01 * found.scale  # each step may rise by a thousandth (`guard.SLACK`)


# --- motions


def test_objects_add_up_and_the_length_of_the_looks_changes_nothing(monkeypatch):
    objects = [sheet(), cloth(2, 2)]
    both = account(scene(*objects), 20)
    apart = [account(scene(one), 20) for one in objects]
    for name in ("kinetic", "elastic", "gravity", "damping", "drag", "total", "numerical"):
        summed = sum(getattr(one, name) for one in apart)
        np.testing.assert_allclose(getattr(both, name), summed, atol=1e-12)
    for method in METHODS:
        made = scene(sheet(), integrationMethod=METHODS[method], delta=0.002)
        motion = simulate(made, 20)
        whole = energies(made, motion)
        for size in (1, 30, 9 * 19):
            monkeypatch.setattr(clothfit.motion.energy, "AT_ONCE", size)
            parts = energies(made, motion)
            for name in ("kinetic", "damping", "drag", "total"):
                np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
        monkeypatch.undo()


@pytest.mark.parametrize("method", list(METHODS))
def test_short_motions_have_the_energies_of_longer_ones(method):
    """Also at their last frame, whose velocity in explicit steps no later position shows."""
    made = scene(sheet(), integrationMethod=METHODS[method], delta=0.002)
    free = ~made.cloths[0].fixed
    start = 0.5 * (made.cloths[0].mass[free, None] * made.cloths[0].velocity[free] ** 2).sum()
    long = account(made, 11)
    for frames in (1, 2, 10):
        found = account(made, frames)
        assert found.total.shape == (frames,)
        np.testing.assert_allclose(found.kinetic[0], start, rtol=1e-11)  # positions of 1 m, differences of 1 mm
        np.testing.assert_allclose(found.kinetic, long.kinetic[:frames], rtol=1e-10)


def test_a_motion_that_does_not_show_every_step_is_refused():
    made = scene(sheet())
    motion = simulate(made, 9)
    for seen, every in ((1.0, 2), (0.5, 1)):
        with pytest.raises(InvalidInput, match=r"need every vertex, and a frame after every step of 0\.02 s"):
            energies(made, degrade(motion, 0.0, seen, every, 0))
    with pytest.raises(InvalidMotion, match="its objects have"):
        energies(made, Motion(motion.positions[:, :4], motion.times, (4,)))


def test_a_spring_of_no_length_pulls_at_nothing_but_holds_its_energy():
    pair = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], stiffness=10.0)
    made, y = unbound(build(scene(pair), 0)), np.zeros((2, 3))
    assert springs.energy(made.springs, y) == 0.5 * 10.0
    assert np.abs(force(made, y, y)).max() == 0.0


def test_an_infinite_energy_is_no_scale_and_is_shown(capsys):
    kinetic, elastic = np.array([1.0, 2.0, 3.0]), np.array([0.5, np.inf, np.inf])
    energy = Energy(np.arange(3.0), kinetic, elastic, *np.zeros((6, 3)))
    assert energy.scale == 3.0
    assert energy.largest_rise == (np.inf, 1)
    assert [joules(value, 1e-12 * energy.scale) for value in energy.elastic] == ["0.5", "inf", "inf"]
    show_energy(Energy(np.arange(2.0), np.array([0.0, np.inf]), *np.zeros((7, 2))), Console())  # none is finite
    assert "the total rises by up to inf J in a step (frame 1) beyond the work of " in capsys.readouterr().out
