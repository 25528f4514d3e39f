"""From the scene to arrays: one System per cloth, the only place where the scene's names become symbols.

Each cloth is a system of its own: what one computes does not depend on the others, and a fit moves only the cloths it
fits. Cloths that touch each other are one system, the vertices and springs of one after those of the other.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import NO_TABLE, Array, Elements, Flags, Indices
from clothfit.base.errors import InvalidScene
from clothfit.engine.forces import applied, bodies, collider_rows, faces, spheres, springs, surfaces, vertex
from clothfit.engine.forces.law import ENDLESS
from clothfit.engine.forces.selfcontact import pairs, rows
from clothfit.engine.inputs import fitted_paths, sampling, tables
from clothfit.engine.solve import sparse
from clothfit.kernels.kernel import record
from clothfit.scene.cloth import SPHERE, Cloth, Collider, together
from clothfit.scene.kinds import AIR, REST
from clothfit.scene.scene import Scene

EXPLICIT, SYMPLECTIC, IMPLICIT, BDF2 = 0, 1, 2, 3
"""Values of the scene's `integrationMethod`."""

FURTHER = 5
"""Iterations that a step may take beyond those of the scene where something touches or moves."""

record(Elements)  # of which every derivative takes a direction or a gradient


@record
class System(NamedTuple):
    """One cloth, constant during a simulation. n vertices."""

    x0: Array  # (n, 3), positions at the start, m
    v0: Array  # (n, 3), velocities at the start, m/s; 0 at fixed vertices that are no pins
    h: float  # time step, s
    method: int  # EXPLICIT, SYMPLECTIC, IMPLICIT or BDF2
    newton_iterations: int  # linear solves per implicit or BDF2 step, at least 1
    guarded: bool  # False: such steps as the format has them, whatever comes of it
    vertex: vertex.Vertex
    springs: springs.Springs
    faces: faces.Faces
    spheres: spheres.Spheres
    colliders: collider_rows.Colliders | None  # None where there are none and nothing changes over time
    pattern: sparse.Pattern  # of the step's matrix
    inputs: tables.Inputs | None  # what changes over time; None where nothing does and there are no colliders
    surface: pairs.Surface | None = None  # what of the cloth can touch itself, nothing where the scene does not ask
    contact: rows.Contact | None = None  # the pairs that press in a step
    applied: applied.Applied | None = None  # forces that are given; these three None with `inputs`


def build(scene: Scene, index: int, air: bool = False, steps: int | None = None, whole: bool = False) -> System:
    """The System of cloth `index` of the scene, for motions of so many steps, those of the scene unless it is said;
    `air` keeps its faces even where the scene gives them no drag, `whole` every part that a scene may have. Raises
    InvalidScene, for inputs in files.
    """
    cloth, layers = cloth_of(scene, index)
    inputs, touched = of_the_world(scene, cloth, scene.frames - 1 if steps is None else steps, whole)
    pattern, slot = sparse.pattern(cloth.springs, ~cloth.fixed)
    surface = surface_of(scene, index) if inputs else None
    own = owners(layers) if inputs else Owners()
    x0 = with_pins(np.array(cloth.positions), cloth.shift, inputs)
    points = vertex.Vertex(
        np.array(cloth.mass), numbers(layers, "damping"), np.array(scene.gravity, float), ~cloth.fixed, own.vertex
    )
    made = System(
        x0=x0,
        v0=at_start(cloth.velocity, cloth.fixed, inputs, scene.delta),
        h=scene.delta,
        method=scene.method,
        newton_iterations=scene.newton_iterations,
        guarded=True,
        vertex=points,
        springs=springs.build(
            np.array(cloth.springs), cloth.rest, cloth.stiffness, numbers(layers, "damping"), slot, own.spring
        ),
        faces=faces.build(
            np.array(cloth.triangles), numbers(layers, "drag"), scene.wind,
            air or cloth.mode("drag") != "n" or scene.method == REST, cloth.drag_law == AIR, own.face
        ),
        spheres=spheres.build([s.centre for s in scene.spheres], [s.radius for s in scene.spheres]),
        colliders=touched and collider_rows.released(touched, points, x0),
        pattern=pattern,
        inputs=inputs,
        surface=surface,
        contact=surface and pairs.none(surface),
        applied=applied.build(*tables.pushed_and_pulled(inputs)) if inputs else None,
    )
    return timeless(scene, made) if scene.method == REST else made


def timeless(scene: Scene, system: System) -> System:
    """The system whose steps end at rest. Raises InvalidScene where the scene has what moves."""
    moving = {
        "wind": bool(scene.wind.any()) or scene.mode("wind") != "n", "inputs over time": scene.moves,
        "pins": any(cloth.pins for cloth in scene.cloths), "selfCollision": scene.self_contact is not None,
        "forces": scene.forces is not None and len(scene.forces.times) > 1,
    }  # fmt: skip
    if found := [name for name, there in moving.items() if there]:
        raise InvalidScene(f"{', '.join(found)}: a scene at rest (integrationMethod 4) has none; leave it out",
                           scene.name)  # fmt: skip
    point, links, face = system.vertex, system.springs, system.faces
    if scene.forces is not None:
        tables.set_inputs(system.inputs, system, 0)
    return system._replace(
        h=ENDLESS, method=IMPLICIT, newton_iterations=1, v0=np.zeros_like(system.v0),
        vertex=point._replace(damping=np.zeros_like(point.damping)),
        springs=links._replace(damping=np.zeros_like(links.damping)),
        faces=face._replace(drag=np.zeros_like(face.drag)),
    )  # fmt: skip


def rests(system: System) -> bool:
    """Whether the steps of a system end at rest."""
    return system.h == ENDLESS


class Owners(NamedTuple):
    """Which of the objects that are simulated together each element belongs to; None where nothing asks."""

    vertex: Indices | None = None  # (n,)
    spring: Indices | None = None  # (S,)
    face: Indices | None = None  # (T,)


def owners(cloths: Sequence[Cloth]) -> Owners:
    """Those of the elements of cloths one after another."""
    counts = zip(*((len(each.mass), len(each.stiffness), len(each.triangles)) for each in cloths), strict=True)
    return Owners(*(np.repeat(np.arange(len(cloths), dtype=np.int32), count) for count in counts))


def numbers(cloths: Sequence[Cloth], name: str) -> Array:
    """A number of each of the cloths, (K,)."""
    return np.array([getattr(each, name) for each in cloths], float)


def cloth_of(scene: Scene, index: int) -> tuple[Cloth, list[Cloth]]:
    """What is simulated as cloth `index`: the cloths that touch each other as one, and each."""
    layers = [scene.cloths[i] for i in scene.together(index)]
    return (together(layers) if len(layers) > 1 else layers[0]), layers


def meets_itself(system: System) -> bool:
    """Whether the cloth touches itself where it can."""
    return system.surface is not None and len(system.surface.start) > 0


def surface_of(scene: Scene, index: int) -> pairs.Surface:
    """What of a cloth can touch itself: nothing where the scene does not ask for that."""
    law = scene.self_contact
    if law is None:
        return pairs.nowhere()
    cloth, numbers = cloth_of(scene, index)[0], (law.thickness, law.stiffness, law.friction, law.release)
    return pairs.surface(cloth.triangles, cloth.positions, cloth.fixed, numbers)


def of_the_world(
    scene: Scene, cloth: Cloth, steps: int, whole: bool
) -> tuple[tables.Inputs | None, collider_rows.Colliders | None]:
    """The inputs over time and the colliders. A scene with any of what moves or touches gets all of it, and what is
    empty does nothing: code is compiled for scenes with none of it and for all others, not for each combination.
    `whole`: all of it for any scene.
    """
    if not (whole or scene.changes or cloth.pins or scene.colliders or scene.self_contact or scene.forces):
        return None, None
    return sampling.build(scene, cloth, steps), at_rest(scene, len(cloth.mass))


def at_rest(scene: Scene, count: int) -> collider_rows.Colliders:
    """The colliders of a scene, where they are at the start, for a cloth of so many vertices. Raises InvalidScene for a
    mesh that cannot be read or is not closed.
    """
    own = scene.colliders
    return collider_rows.build(
        [shape_of(each) for each in own],
        [(each.thickness, each.stiffness, each.friction) for each in own],
        sampling.states(own, np.zeros(1), scene.delta, 0)[0],
        meshes_of(scene, count),
        count,
        scene.newton_iterations + FURTHER if scene.method in (IMPLICIT, BDF2) else 1,
        [each.release for each in own],
    )


def meshes_of(scene: Scene, count: int) -> bodies.Bodies:
    """The meshes among the colliders, for a cloth of so many vertices."""
    if not any(each.body for each in scene.colliders):
        return bodies.build([], count)
    from clothfit.engine.inputs.body_files import bodies_of  # what reads all formats, which few scenes need

    try:
        return bodies.build([each.surface for each in bodies_of(scene.colliders)], count)
    except InvalidScene as error:
        raise InvalidScene(error.problems, scene.name) from None


def shape_of(collider: Collider) -> int:
    """The surface of a collider: a sphere is a cone without length."""
    return surfaces.CONE if collider.kind == SPHERE else collider.kind


def at_start(velocity: Array, fixed: Flags, inputs: tables.Inputs | None, h: float) -> Array:
    """A copy of the velocities (n, 3), 0 at fixed vertices; those of the pins are the ones of their first step, and
    where the axes of the scene move their velocity is added.
    """
    own = np.ascontiguousarray(np.where(fixed[:, None], 0.0, velocity))
    if inputs is not None and len(inputs.drift):
        own += inputs.drift
    if inputs is not None and len(inputs.path):
        own[inputs.pins] = (inputs.path[1] - inputs.path[0]) / h
    return own


def with_pins(x0: Array, shift: Array, inputs: tables.Inputs | None) -> Array:
    """The positions x0 (n, 3) at the start, m; the pins are on their path where an offset has moved that."""
    if inputs is not None and len(inputs.path) and shift.any():
        x0[inputs.pins] = inputs.path[0]
    return x0


def mobile(system: System) -> Flags:
    """Which vertices (n,) parameters can move: those that are free, and pins whose paths are fitted."""
    return np.asarray(system.vertex.free | tables.led(system.inputs, len(system.x0)))


def with_elements(system: System, values: Elements) -> System:
    """The same system with other values, those that are not empty; nothing else is built again."""
    point, spring, face, v0 = system.vertex, system.springs, system.faces, system.v0
    point = point._replace(mass=np.array(values.mass, float))
    spring = spring._replace(stiffness=np.array(values.stiffness, float))
    if len(values.damping):
        point = point._replace(damping=np.array(values.damping, float))
        spring = spring._replace(damping=0.5 * values.damping)
    if len(values.drag):
        face = face._replace(drag=np.array(values.drag, float))
    if len(values.path) or len(values.shift):
        system = with_paths(system, values)
        v0 = system.v0
    if len(values.velocity):
        v0 = at_start(values.velocity, ~point.free, system.inputs, system.h)
    if len(values.rest):
        spring = spring._replace(rest=np.array(values.rest, float))
    system = with_contacts(system, values)
    if system.inputs is not None:
        return with_bases(system._replace(v0=v0, vertex=point, springs=spring, faces=face), system.inputs, values)
    if len(values.wind):
        face = face._replace(wind=np.array(values.wind, float))
    if len(values.gravity):
        point = point._replace(gravity=np.array(values.gravity, float))
    return system._replace(v0=v0, vertex=point, springs=spring, faces=face)


def with_paths(system: System, values: Elements) -> System:
    """The system with pins on other paths."""
    assert system.inputs is not None
    fitted = fitted_paths.with_values(system.inputs.fitted, values.path, values.shift)
    inputs, x0, v0 = system.inputs._replace(fitted=fitted, path=fitted.path), system.x0, system.v0.copy()
    if len(values.shift):
        x0 = x0.copy()
        x0[inputs.pins] = inputs.path[0]
    v0[inputs.pins] = (inputs.path[1] - inputs.path[0]) / system.h
    return system._replace(x0=x0, v0=v0, inputs=inputs)


def with_contacts(system: System, values: Elements) -> System:
    """The system with other laws and places of its colliders, where they are not empty; their places are those that the
    system has, moved by the offset.
    """
    own, ball, inputs, offset = system.colliders, system.spheres, system.inputs, values.offset
    if own is not None and (len(values.friction) or len(values.contact) or len(offset)):
        own = own._replace(rows=own.rows.copy())
        for column, numbers in ((collider_rows.FRICTION, values.friction), (collider_rows.STIFFNESS, values.contact)):
            if len(numbers):
                own.rows[:, collider_rows.LAW, column] = numbers[: len(own.rows)]
        if len(offset):
            own.rows[:, collider_rows.PLACE] += offset
            own = collider_rows.released(own, system.vertex, system.x0)
    if len(offset):
        ball = ball._replace(centre=ball.centre + offset)
        inputs = tables.with_offset(inputs, len(ball.centre), offset)
    return with_own_law(system._replace(colliders=own, spheres=ball, inputs=inputs), values)


def with_own_law(system: System, values: Elements) -> System:
    """The system with another law of its contact with itself: the last friction and stiffness, where not empty."""
    own = system.surface
    if own is None or not meets_itself(system) or not (len(values.friction) or len(values.contact)):
        return system
    if len(values.friction):
        own = own._replace(friction=float(values.friction[-1]))
    if len(values.contact):
        own = own._replace(stiffness=float(values.contact[-1]))
    return system._replace(surface=own, contact=pairs.none(own))


def with_bases(system: System, inputs: tables.Inputs, values: Elements) -> System:
    """A system with inputs over time whose constant parts are these values, where they are not empty, and with memory
    of its own for those of the step that is computed.
    """
    own, given = system.colliders, system.applied
    if len(values.force):
        inputs = inputs._replace(force=np.array(values.force, float))
    if len(values.gusts):
        inputs = inputs._replace(gusts=np.array(values.gusts, float), wind=inputs.share @ values.gusts)
    wind = np.array(values.wind if len(values.wind) else inputs.wind_base, float)
    gravity = np.array(values.gravity if len(values.gravity) else inputs.gravity_base, float)
    return system._replace(
        vertex=system.vertex._replace(gravity=gravity.copy()),
        faces=system.faces._replace(wind=wind.copy()),
        spheres=system.spheres._replace(centre=system.spheres.centre.copy()),
        colliders=own and collider_rows.copied(own),
        applied=given and applied.Applied(*(each.copy() for each in given)),
        inputs=inputs._replace(
            wind_base=wind, gravity_base=gravity, place=inputs.place.copy(), later=inputs.later.copy(),
            fitted=fitted_paths.with_values(inputs.fitted, values.path, values.shift),
        ),
    )


def clamped(system: System) -> System:
    """The same system with a matrix of the step that is positive definite whatever the state; see `springs`."""
    return system._replace(springs=system.springs._replace(cap=1.0))


def predictive(system: System) -> System:
    """The same system whose steps also know the contacts that they begin; see `spheres.enters`."""
    return system._replace(spheres=system.spheres._replace(predictive=True))


def all_elements(system: System) -> Elements:
    """The values that a system has now, every kind of them, copied."""
    inputs = system.inputs
    fitted = None if inputs is None or not len(inputs.fitted.pin) else inputs.fitted
    friction, contact = laws(system)
    return Elements(
        mass=system.vertex.mass.copy(),
        stiffness=system.springs.stiffness.copy(),
        damping=system.vertex.damping.copy(),
        drag=system.faces.drag.copy(),
        velocity=system.v0.copy(),
        rest=system.springs.rest.copy(),
        path=np.zeros((0, 3)) if fitted is None else fitted.keys.copy(),
        shift=np.zeros(0) if fitted is None else fitted.offset.copy(),
        wind=(system.faces.wind if inputs is None else inputs.wind_base).copy(),
        gravity=(system.vertex.gravity if inputs is None else inputs.gravity_base).copy(),
        gusts=np.zeros((0, 3)) if inputs is None else inputs.gusts.copy(),
        friction=friction,
        contact=contact,
        offset=np.zeros(3),
        force=NO_TABLE if inputs is None else inputs.force.copy(),
    )


def laws(system: System) -> tuple[Array, Array]:
    """The coefficients of friction and the stiffnesses, N/m, of the colliders, then of the contact with itself."""
    touched, own = system.colliders, system.surface
    friction, stiffness = (np.zeros(0), np.zeros(0)) if touched is None else (touched.friction, touched.stiffness)
    if own is None or not meets_itself(system):
        return friction.copy(), stiffness.copy()
    return np.append(friction, own.friction), np.append(stiffness, own.stiffness)


def zeros(system: System, kinds: Collection[str] = ()) -> Elements:
    """Zeros for masses, stiffnesses and the other `kinds` that are named; what is not named is empty."""
    own = all_elements(system)
    return Elements(**{name: np.zeros_like(getattr(own, name)) for name in ("mass", "stiffness", *kinds)})
