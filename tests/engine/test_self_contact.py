"""Self-contact: closest points and pairs against brute force, forces against closed forms and differences, steps that
do not pass through themselves, and exact derivatives.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from helpers import physics
from helpers.derivatives import assert_derivatives
from helpers.physics import METHODS, keys, relative, rotation, scene, thing, xyz

from clothfit import energies, simulate
from clothfit.engine.contact_steps import with_pairs
from clothfit.engine.forces import boxes, contact
from clothfit.engine.forces.selfcontact import nearest, pairs, rows, zones
from clothfit.engine.rollout import rollout
from clothfit.engine.solve import sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import build, zeros
from clothfit.evaluation.gradient_check import contacts, first_switch, name_of

TIGHT = 1e-13
G = 9.81
KINDS = [nearest.CORNER, nearest.EDGE]
OWN = np.arange(4)


def grid(nx, nz, place):
    """Points, springs and triangles of a sheet of nx × nz vertices at `place(i, j)`."""
    index = np.arange(nx * nz).reshape(nx, nz)
    points = [place(i, j) for i in range(nx) for j in range(nz)]
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)
    rows = np.stack([index[:, :-1], index[:, 1:]], -1).reshape(-1, 2)
    columns = np.stack([index[:-1], index[1:]], -1).reshape(-1, 2)
    springs = np.concatenate([quads[:, [0, 2]], quads[:, [1, 3]], rows, columns])
    return np.array(points, float), springs, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def two_sheets(gap, shift=(0.0, 0.0), nx=3):
    """Two sheets, the second one above the first, as one object."""
    one, springs, faces = grid(nx, nx, lambda i, j: (0.2 * i, 0.0, 0.2 * j))
    other = one + [shift[0], gap, shift[1]]
    count = len(one)
    both = (np.concatenate([part, part + count]) for part in (springs, faces))
    return np.concatenate([one, other]), *both


def touching(points, springs, faces, law, **fields):
    """A scene of one object that touches itself; fields of an object go to it, all others to the scene."""
    own = {name: fields.pop(name) for name in list(fields) if name in OF_OBJECTS or name in thing([])}
    return scene(thing(points, springs, faces, **own), selfCollision=law, **fields)


OF_OBJECTS = ("mass", "stiffness", "fixed", "pins", "vertVel")


# --- closest points


def brute(kind, x):
    """The distance of a pair by the best of all its features: corners, edges, the inside."""
    def point(p, q):
        return np.linalg.norm(p - q)

    def segment(p, a, b):
        t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return point(p, a + t * (b - a))

    if kind == nearest.CORNER:
        p, corners = x[0], x[1:]
        found = [segment(p, corners[i], corners[j]) for i, j in ((0, 1), (1, 2), (0, 2))]
        n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        foot = p - n * ((p - corners[0]) @ n) / (n @ n)
        share = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.append(foot, 1), rcond=None)[0]
        return min(found + ([point(p, foot)] if (share >= 0).all() else []))
    a, b, e, f = x
    found = [segment(a, e, f), segment(b, e, f), segment(e, a, b), segment(f, a, b)]
    n = np.cross(b - a, f - e)
    if np.linalg.norm(n) < 1e-12:  # parallel: a corner is nearest
        return min(found)
    s, t = np.linalg.lstsq(np.stack([b - a, e - f], 1), e - a, rcond=None)[0]
    return min(found + ([abs((e - a) @ n) / np.linalg.norm(n)] if 0 <= s <= 1 and 0 <= t <= 1 else []))


@pytest.mark.parametrize("kind", KINDS)
def test_the_distance_is_the_least_of_all_features(kind):
    for x in np.random.default_rng(kind).normal(size=(100, 4, 3)):
        assert nearest.distance(kind, OWN, x) == pytest.approx(brute(kind, x), rel=1e-12)


def law_of(x, kind, friction=0.0, thickness=5.0):
    """A contact of one pair at x (4, 3)."""
    sides = np.array([nearest.side(kind, OWN, x)])
    own = np.array([OWN], np.int32), np.array([kind], np.int32), np.array([thickness]), sides
    alone = np.ones((1, 1), bool), np.zeros(1, np.int32), np.full(1, np.inf), np.arange(6, dtype=np.int32)[None]
    return rows.Contact(*own, np.ones(4), 0.1, 300.0, friction, *alone)


def push(made, y, u):
    f = np.zeros_like(y)
    contact.add_force(made, y, u, f)
    return f


@pytest.mark.parametrize("friction", [0.0, 0.7])
@pytest.mark.parametrize("kind", KINDS)
def test_the_forces_of_a_pair_are_the_slope_of_its_energy_and_have_no_sum_and_no_moment(kind, friction):
    t = 1e-6
    for x, u, d in np.random.default_rng(6).normal(size=(60, 3, 4, 3)):
        made = law_of(x, kind, friction)
        f = push(made, x, u)
        np.testing.assert_allclose(f.sum(axis=0), 0, atol=1e-12 * np.abs(f).max())
        if friction:  # what rubs acts at both of two points, which are apart
            continue
        np.testing.assert_allclose(np.cross(x, f).sum(axis=0), 0, atol=1e-11 * np.abs(f).max())
        slope = (contact.energy(made, x + t * d) - contact.energy(made, x - t * d)) / (2 * t)
        if nearest.share(kind, OWN, x) == 1.0:  # no kink, where another feature becomes the nearest, is met
            assert -np.vdot(f, d) == pytest.approx(slope, rel=1e-6, abs=1e-5)


def parallel(rng):
    """Two edges that are almost parallel."""
    x = rng.normal(size=(4, 3))
    x[3] = x[2] + 1.3 * (x[1] - x[0]) + 0.05 * rng.normal(size=3)
    return x


@pytest.mark.parametrize("friction", [0.0, 0.7])
@pytest.mark.parametrize("kind", [*KINDS, "parallel"])
def test_the_derivatives_of_the_model(kind, friction):
    rng, t, h = np.random.default_rng(7), 1e-6, 0.1
    one = build(scene(thing(np.eye(4, 3), mass=1.0)), 0)
    for _ in range(40):
        x = parallel(rng) if kind == "parallel" else rng.normal(size=(4, 3))
        made = law_of(x, nearest.EDGE if kind == "parallel" else kind, friction)
        u, w, lam, dy, du = rng.normal(size=(5, 4, 3))
        s = 0.1 * rng.normal(size=(4, 3))
        one, direction = one._replace(contact=made), zeros(one)

        def model(y, u, made=made, s=s, w=w, one=one):
            A, _, slot = sparse.joined(sparse.zeros(one.pattern, 4), made.vertices, made.free > 0.0)
            made = made._replace(slot=slot)
            sparse.reset(A, np.zeros(4))
            b, out = np.zeros((4, 3)), np.zeros((4, 3))
            contact.add_step(made, y, u, h, False, A, b)
            sparse.multiply(A, s, out)
            rub = np.zeros((4, 3))
            contact.add_damping(made, y, u, 1.0, h * w - s, rub)
            return b - out / h + rub

        measured = (model(x + t * dy, u + t * du) - model(x - t * dy, u - t * du)) / (2 * t)
        out, gy, gu = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3))
        contact.add_pushforward(made, x, u, w, s, dy, du, direction, h, out)
        contact.add_pullback(made, x, u, w, s, lam, h, zeros(one), gy, gu)
        # the third derivative over some tenths of a metre, at 1e-6; near parallel edges over hundredths
        assert relative(out, measured) < (1e-4 if kind == "parallel" else 1e-6)
        back = np.vdot(gy, dy) + np.vdot(gu, du)
        assert abs(np.vdot(lam, out) - back) < 1e-11 * np.abs(lam * out).sum()


# --- pairs


def test_boxes_that_overlap_are_those_of_brute_force():
    rng = np.random.default_rng(8)
    low, other = rng.uniform(size=(300, 3)), rng.uniform(size=(200, 3))
    high, top = low + 0.2 * rng.uniform(size=low.shape) ** 3, other + 0.3 * rng.uniform(size=other.shape) ** 4
    points = np.concatenate([low, high, other, top])
    own, others = (
        boxes.parts(first + np.stack([np.arange(n), n + np.arange(n)], 1).astype(np.int32), points)
        for first, n in ((0, 300), (600, 200))
    )
    nothing = boxes.parts(np.zeros((0, 2), np.int32), points)
    meet = (low[:, None] <= top).all(axis=2) & (other <= high[:, None]).all(axis=2)
    each_other = np.triu((low[:, None] <= high).all(axis=2) & (low <= high[:, None]).all(axis=2), 1)
    for given, expected in (((own, others), meet), ((own, own), each_other), ((nothing, others), meet[:0])):
        found = boxes.overlapping(*given, points, 0 * points, 0.0, 0.0).tolist()
        assert sorted(map(tuple, found)) == sorted(map(tuple, np.argwhere(expected).tolist()))


def crumpled(n=6, seed=9, **law):
    """A sheet with random places: everything near everything."""
    points, springs, faces = grid(n, n, lambda i, j: (0.1 * i, 0.0, 0.1 * j))
    made = build(touching(points, springs, faces, {"thickness": 0.04, **law}), 0)
    return made, points + 0.05 * np.random.default_rng(seed).normal(size=points.shape)


def by_hand(surface, x):
    """The numbers of the pairs that are near, from all pairs."""
    n, faces, edges = len(x), surface.triangles, surface.edges
    found = []
    for v, (t, corners) in itertools.product(range(n), enumerate(faces)):
        own = [v, *corners]
        if v not in corners and brute(nearest.CORNER, x[own]) < thickness(surface, nearest.CORNER, own):
            found.append(v * len(faces) + t)
    for (e, one), (f, other) in itertools.combinations(enumerate(edges), 2):
        own = [*one, *other]
        if len(set(own)) == 4 and brute(nearest.EDGE, x[own]) < thickness(surface, nearest.EDGE, own):
            found.append(n * len(faces) + e * len(edges) + f)
    return found


def thickness(surface, kind, own):
    """That of a pair, from the distance at the start."""
    first = brute(kind, surface.start[own])
    ends = 1 if kind == nearest.CORNER else 2
    sides = {tuple(edge) for edge in surface.edges.tolist()}
    joined = any(tuple(sorted((int(a), int(b)))) in sides for a in own[:ends] for b in own[ends:])
    return min(surface.thickness, first * (0.5 if joined else 1.0))


@pytest.mark.parametrize("d", [0.04, 0.15])
def test_near_pairs_are_those_of_brute_force(d):
    made, x = crumpled(5, thickness=d)
    found = pairs.near(made.surface, x)
    assert len(found) > 20
    assert found.tolist() == by_hand(made.surface, x)


def passing(system, after):
    """The numbers of the pairs that would pass through each other from the start on."""
    start = system.surface.start
    return pairs.crossing(system.surface, start, after, pairs.colliding(system.surface, start, after))


def test_pairs_that_pass_through_each_other_are_found():
    points, springs, faces = two_sheets(0.1, (0.03, 0.05))
    made = build(touching(points, springs, faces, {"thickness": 0.01}), 0)
    upper = np.arange(len(points)) >= len(points) // 2
    assert not len(passing(made, points - [0, 5.0, 0]))  # all together
    assert not len(passing(made, points - upper[:, None] * [0, 0.08, 0]))
    found = passing(made, points - upper[:, None] * [0, 7.0, 0])
    kinds = pairs.of_numbers(made.surface, points, found).kind
    assert {nearest.CORNER, nearest.EDGE} == set(kinds)


# --- motions


@pytest.mark.slow
def test_a_sheet_on_a_sheet_rests_where_the_push_carries_its_weight():
    made = touching(
        *two_sheets(0.02), {"thickness": 0.02, "stiffness": 50.0}, mass=0.01, stiffness=20.0, damping=4.0,
        fixed=range(9), delta=0.01, optimizationIterations=60, tolerance=1e-10,
    )  # fmt: skip
    motion = simulate(made)  # long before it slides off, for it stands on points
    system, x, half = build(made, 0), motion.positions[-1], 9
    near = pairs.contact_at(system.surface, x)
    up = push(near, x, 0 * x)[half:, 1].sum()
    assert up == pytest.approx(half * 0.01 * G, rel=1e-6)
    # each vertex of the upper sheet over one of the lower: it is as near to all triangles there as to that vertex
    depth = 0.02 - (x[half:, 1] - x[:half, 1])
    assert (depth > 0).all()
    total = sum(
        50.0 * (0.02 - nearest.distance(near.kind[k], near.vertices[k], x)) * share
        for k in range(len(near.kind))
        if (share := nearest.share(near.kind[k], near.vertices[k], x)) > 0
    )
    assert total == pytest.approx(half * 0.01 * G, rel=0.02)  # normals that are almost upright
    assert energies(made, motion).contact[-1] == pytest.approx(contact.energy(near, x), rel=1e-12)


def colliding(method="implicit", newton=1, friction=0.0, frames=8, speed=1.5, mass=0.02, **fields):
    """A strip that is folded in the middle, its halves on their way to each other."""
    def place(i, j):
        if i < 5:
            return 0.2 * i, 0.01 * np.sin(3 * i + j), 0.2 * j
        return 0.87 - 0.2 * (i - 5), 0.06 + 0.01 * np.cos(2 * i + 1.7 * j), 0.2 * j + 0.05 + 0.01 * i

    points, springs, faces = grid(10, 3, place)
    rng = np.random.default_rng(0)
    v = 0.3 * rng.normal(size=points.shape)
    v[:15, 1] += speed
    v[15:] += [0.5, -speed, 0]
    return touching(
        points, springs, faces, {"thickness": 0.05, "stiffness": 400.0, "friction": friction}, mass=mass,
        stiffness=60.0, delta=0.005, integrationMethod=METHODS[method], forwardSubSteps=newton,
        optimizationIterations=frames, tolerance=TIGHT,
        **{"damping": 0.3, "fixed": [0], "vertVel": [xyz(a) for a in v], **fields},
    )  # fmt: skip


LETTERED = {"optimizationSettings": "LL", "fit": {"friction": "G", "contact": "G"}}


def pushed(speed):
    """Fields of a strip whose lower half is led upwards."""
    path = [{"vertices": list(range(15)), "posKeys": keys([0, 1], [(0, 0, 0), (0, speed, 0)])}]
    return {"fixed": range(15), "pins": path}


MOTIONS = {
    "explicit": ("explicit", 1, 0.4, {}),
    "symplectic": ("symplectic", 1, 0.0, {}),
    "Newton": ("implicit", 3, 0.4, {"speed": 1.45}),  # at 1.5 m/s a pair switches within the long steps
    "bdf2": ("bdf2", 1, 0.4, {}),
    "zones": ("implicit", 1, 0.0, {"speed": 20.0, "frames": 5}),
    "pins": ("implicit", 2, 0.3, pushed(2.2)),
    "pins, bdf2": ("bdf2", 1, 0.3, pushed(2.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTIONS)
def test_gradient_tangent_and_columns(name):
    method, newton, friction, own = MOTIONS[name]
    made = colliding(method, newton, friction, **LETTERED, **own)
    part = rollout(build(made, 0), made.frames - 1, TIGHT)[0]
    assert max(len(each.numbers) for each in part.active_pairs) > 10
    # in another order they would be of another type, for which all is compiled again
    assert all(each.on.flags.c_contiguous for each in part.active_pairs if each.on is not None)
    assert any(each.zones is not None for each in part.active_pairs) == (name == "zones")
    # systems are solved to 1e-13, and friction makes their condition about 1e4
    assert_derivatives(made, TIGHT, 1e-10, 1e-9, switches=name == "bdf2")


@pytest.mark.slow
def test_pins_push_as_heavy_vertices_do():
    own = {"friction": 0.3, "gravity": xyz((0, 0, 0)), "damping": 0.0}
    pinned = colliding(**own, **pushed(1.5))
    v = pinned.cloths[0].velocity.copy()
    v[:15] = [0, 1.5, 0]
    heavy = colliding(**own, fixed=[], mass=[1e5] * 15 + [0.02] * 15, vertVel=[xyz(a) for a in v])
    part = rollout(build(pinned, 0), 7, TIGHT)[0]
    np.testing.assert_allclose(part.w[3, 0, :15], np.broadcast_to([0, 1.5, 0], (15, 3)), atol=1e-9)
    assert max(len(each.numbers) for each in part.active_pairs) > 10
    # the heavy ones are moved by some 0.1 N s/1e5 kg, and systems are solved to 1e-13 of these masses
    np.testing.assert_allclose(part.x, simulate(heavy).positions, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_sheet_slides_down_a_sheet(friction):
    angle, h, count = 0.5, 2e-3, 120
    lower, one, faces = grid(9, 7, lambda i, j: (0.1 * i, 0.0, 0.1 * j))
    upper, other, more = grid(3, 3, lambda i, j: (0.63 + 0.06 * i, 0.02, 0.21 + 0.06 * j))
    n, turn = len(lower), rotation((0, 0, 1), angle)
    made = touching(
        np.concatenate([lower, upper]) @ turn.T, np.concatenate([one, other + n]), np.concatenate([faces, more + n]),
        {"thickness": 0.02, "stiffness": 2000.0, "friction": friction}, mass=0.01, stiffness=300.0, fixed=range(n),
        delta=h, optimizationIterations=count + 1, integrationMethod=2, forwardSubSteps=3, tolerance=1e-10,
    )  # fmt: skip
    way = -((simulate(made).positions[:, n:] - made.cloths[0].positions[n:]) @ turn[:, 0]).mean(axis=1)
    half = count // 2
    a = (way[-1] - 2 * way[half] + way[0]) / (half * h) ** 2
    # friction begins within the first steps, and pushes are upright but at the border of the lower sheet
    assert a == pytest.approx(G * (np.sin(angle) - friction * np.cos(angle)), rel=0.02)


def crossings(surface, x):
    """How many edges pass through triangles, with which they share no vertex."""
    return len(pairs.pierced(surface._replace(start=x)))


@pytest.mark.slow
@pytest.mark.parametrize(("method", "speed"), [("implicit", 1.5), ("implicit", 60.0), ("bdf2", 10.0)])
def test_halves_that_meet_do_not_pass_through_each_other(method, speed):
    made = colliding(method, speed=speed, frames=20)
    surface = build(made, 0).surface
    free = simulate(replace(made, self_contact=None)).positions
    assert max(crossings(surface, x) for x in free) > 0  # without, they do
    assert [crossings(surface, x) for x in simulate(made).positions] == [0] * 20


def test_zones_keep_the_momentum_and_are_their_own_transpose():
    made = build(colliding(fixed=[3]), 0)
    rng = np.random.default_rng(4)
    u, dx, dv, x_bar, v_bar = rng.normal(size=(5, *made.x0.shape))
    own = zones.of_pairs(np.array([[0, 1, 2, 7], [7, 8, 9, 10], [3, 4, 5, 6], [20, 21, 22, 23]]), len(u), u)
    w = u.copy()
    zones.join(own, made.vertex, w)
    assert len(own.first) == 4  # three zones
    assert np.ptp(w[[0, 1, 2, 7, 8, 9, 10]], axis=0).max() < 1e-15
    np.testing.assert_allclose(w[[4, 5, 6]], np.broadcast_to(u[3], (3, 3)), atol=1e-15)
    np.testing.assert_allclose(w[[20, 21, 22, 23]].sum(axis=0), u[[20, 21, 22, 23]].sum(axis=0), atol=1e-14)
    grad, direction = zeros(made), zeros(made)
    direction.mass[:] = rng.normal(size=len(u))
    out_x, out_v, in_v = dx.copy(), dv.copy(), v_bar.copy()
    zones.push(own, made.vertex, 0.1, direction, out_x, out_v)
    zones.pull(own, made.vertex, 0.1, x_bar, in_v, grad)
    # x + h w comes in as x + h u: dx has h dv in it, so its change is what is compared
    after = np.vdot(x_bar, out_x) + np.vdot(v_bar, out_v)
    before = np.vdot(x_bar, dx) + np.vdot(in_v, dv) + grad.mass @ direction.mass
    assert after == pytest.approx(before, rel=1e-12)


def test_the_matrix_with_pairs_is_the_same_in_all_its_forms():
    made, x = crumpled(4)
    work = implicit.workspace(made)
    system, work = with_pairs(made, work, made.surface, x, pairs.near(made.surface, x))
    A, rng = work.A, np.random.default_rng(1)
    implicit.assemble(system, x, rng.normal(size=x.shape), False, A, work.b)
    columns = np.stack([physics.times(A, e.reshape(x.shape)).ravel() for e in np.eye(x.size)], axis=1)
    np.testing.assert_allclose(sparse.to_scipy(*A).toarray(), columns, atol=1e-12 * np.abs(columns).max())
    np.testing.assert_allclose(columns, columns.T, atol=1e-12 * np.abs(columns).max())


# --- scenes


@pytest.mark.slow
def test_check_names_what_switches():
    made = colliding()
    system = build(made, 0)
    one, other = (contacts(each, rollout(each, 7, TIGHT)[0]) for each in (system, system._replace(v0=0.9 * system.v0)))
    assert first_switch(one, one) is None
    found = first_switch(one, other)
    assert found.at(name_of(made, found.obstacle)).endswith("the cloth itself, step 1")


def test_seams_that_are_not_welded_pass():
    points, springs, faces = two_sheets(0.0)
    made = build(touching(points, springs, faces, {"thickness": 0.01}), 0)
    lower = np.arange(len(points)) < len(points) // 2
    assert not len(pairs.near(made.surface, points))
    assert not len(passing(made, points + lower[:, None] * [0, 1.0, 0]))
