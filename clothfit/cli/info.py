"""`clothfit info`: what is in a file?"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import doubts
from clothfit.base.memory import free, human
from clothfit.base.messages import counted, owned
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import OF_SCENES, read_scene, vector
from clothfit.cli.common.options import standard_command
from clothfit.cli.common.output import Printed, attributes, print_json
from clothfit.formats.registry import CHECKPOINT, EITHER, EXPORT, FORCES, LOG, MAP, MESH, MOTION, PAGE, kind_of
from clothfit.scene.kinds import EDITORS, INTEGRATORS, OF_THE_EDITOR

if TYPE_CHECKING:
    from clothfit.evaluation.forecast import Forecast
    from clothfit.evaluation.overview import Facts, Flagged, Spread
    from clothfit.scene.cloth import Collider
    from clothfit.scene.scene import Scene

OBJECTS_IN_A_TABLE = 4
"""Objects in one table."""

RECORDS = (MOTION, MESH, EITHER, CHECKPOINT, LOG, FORCES)
"""Kinds of files that are no scenes, and have something to print."""

OTHERS = {
    PAGE: "a page; open it in a browser",
    MAP: "a map of markers to vertices; it goes with --map",
    EXPORT: "an export for another tool; name the scene that it was made of",
}
"""What is said of kinds of files that have nothing to print."""

MOST_LISTED = 5
"""Parts and spheres that are told one by one."""


@standard_command("info")
@click.argument("path_given", metavar="FILE")
def command(path_given: str, console: Console) -> None:
    """Print what FILE holds. Of a scene: counts, masses, stiffnesses, the parameters to fit, the stable steps and the
    memory it takes; of a motion: frames, points, rate, axes, size, gaps. Meshes, forces, checkpoints and logs are known
    too.

    \b
    clothfit info scene.json
    clothfit info capture.c3d
    clothfit info shirt.obj --json
    """
    kind = kind_of(path_given)
    if kind in RECORDS:
        show_record(path_given, str(kind), console)
    elif kind in OTHERS:
        raise InvalidInput(f"{path_given} is {OTHERS[kind]}")
    else:
        of_scene(path_given, console)


def show_record(path: str, kind: str, console: Console) -> None:
    """Print what a file holds that is no scene."""
    from clothfit.cli.parts import info_records

    named = {EITHER: "either", MESH: "either", FORCES: "forces"}.get(kind, kind)
    own = getattr(info_records, named)(path)
    console.warn(*own["warnings"], of=os.path.basename(path))
    rows = getattr(info_records, f"{own['kind']}_rows")(own)
    console.result(f"{os.path.basename(path)}: {own['kind']}")
    console.result("\n".join(f"{name:<13}  {cell}" for name, cell in rows.items()))
    print_json(own)


def of_scene(scene_path: str, console: Console) -> None:
    """Print what a scene holds."""
    scene = read_scene(scene_path, console)
    from clothfit.engine.starts import sentences
    from clothfit.evaluation import overview
    from clothfit.evaluation.forecast import forecast, inputs_of
    from clothfit.fabric.fabric import fabric_of, rows_of
    from clothfit.fit.flags import auto_flags
    from clothfit.scene.mesh_numbering import numberings
    from clothfit.subspace.break_even import break_even

    objects = [overview.facts(cloth) for cloth in scene.cloths]
    wanted = overview.flagged(auto_flags(scene) if scene.auto else scene)
    fabrics = [fabric_of(cloth) for cloth in scene.cloths]
    parted = [overview.divisions(cloth) for cloth in scene.cloths]
    ahead, strange = forecast(scene), list(overview.unknown_fields(scene))
    meshes = [None if each is None else len(each) for each in numberings(scene)]
    console.warn(*overview.misspelt_fields(scene), *overview.beyond_bounds(scene), of=scene.name)
    sizes = [[b - a for a, b in zip(own.low, own.high, strict=True)] for own in objects]
    unlikely = [doubts(size, own.mass.total, OF_SCENES) for size, own in zip(sizes, objects, strict=True)]
    moving, starts = inputs_of(scene), sentences(scene)
    show_scene(scene, console)
    console.warn(*starts, of=scene.name)
    if scene.auto:
        console.result("a fit chooses by itself (auto) among what is to fit")
    for each in moving:
        console.result(str(each))
    for begin in range(0, len(objects), OBJECTS_IN_A_TABLE):
        chosen = range(len(objects))[begin : begin + OBJECTS_IN_A_TABLE]
        columns = [
            column(objects[index], [each for each in wanted if each.object == index]) | rows_of(fabrics[index])
            for index in chosen
        ]
        cells = [[name, *(each[name] for each in columns)] for name in columns[0]]
        console.table([["", *(f"objects[{index}]" for index in chosen)], *cells])
    for index, own in enumerate(parted):
        console.result(*own.sentences, of=f"objects[{index}]")
    for index, count in enumerate(meshes):
        if count is not None:
            console.result(f"objects[{index}] was welded from a mesh of {count} vertices")
    show_rest(scene, ahead, [each.name for each in wanted if each.object is None], strange, console)
    if Printed.as_json:
        needed = {"motion": ahead.motion, "fit": ahead.fit, "free": free()}
        ahead_of = break_even(scene)
        print_json({
            **whole(scene),
            "objects": [
                {**asdict(own), "mesh_vertices": count, **asdict(part), "fabric": cloth}
                for own, count, part, cloth in zip(objects, meshes, parted, fabrics, strict=True)
            ],
            "flagged": wanted, "inputs": [each._asdict() for each in moving], "stability": ahead.steps,
            "memory": needed, "unknown_fields": strange, "subspace": {} if ahead_of is None else ahead_of._asdict(),
            "warnings": [*scene.warnings, *starts], "doubts": unlikely,
        })  # fmt: skip


def whole(scene: Scene) -> dict[str, Any]:
    """What --json prints of the scene as a whole."""
    return {
        "kind": "scene",
        "scene": scene.name,
        "integrator": INTEGRATORS[scene.method],
        "of_the_editor": INTEGRATORS[scene.method] in OF_THE_EDITOR,
        **attributes(scene, "title", "delta", "frames", "tolerance", "newton_iterations", "wind", "gravity"),
        "duration": scene.delta * (scene.frames - 1),
        "spheres": [attributes(each, "centre", "radius") for each in scene.spheres],
        "colliders": [described(each) for each in scene.colliders],
        "self_collision": scene.self_contact and asdict(scene.self_contact),
    }


def described(collider: Collider) -> dict[str, Any]:
    """What there is to say of a collider that is no plain sphere."""
    from clothfit.scene.cloth import BOX, CAPSULE, MESH, SPHERE

    first, second, third = collider.size.tolist()
    cone = {"radius": first, "radius2": second, "height": third}
    size = {CAPSULE: cone, BOX: {"lengths": (2 * collider.size).tolist()}, SPHERE: {"radius": first}}
    return {
        "shape": collider.name,
        **(mesh(collider) if collider.kind == MESH else size.get(collider.kind, {})),
        **attributes(collider, "centre", "angles", "thickness", "stiffness", "friction", "moves"),
    }


def mesh(collider: Collider) -> dict[str, Any]:
    """What there is to say of a mesh: its size is that of the box about it where it begins."""
    from clothfit.engine.inputs.body_files import body_of

    assert collider.body is not None
    place, triangles, _ = body_of(collider).surface
    size = (place.max(axis=0) - place.min(axis=0)).tolist()
    return {"file": collider.body.file, "vertices": len(place), "triangles": len(triangles), "lengths": size}


def collider_line(own: dict[str, Any]) -> str:
    """The same in a line."""
    sizes: dict[str, str] = {name: f"{own[name]:.4g} m" for name in ("radius", "radius2", "height") if name in own}
    if "lengths" in own:
        sizes["lengths"] = f"{vector(own['lengths'])} m"
    faces = [f"{own['triangles']} triangles"] if "triangles" in own else []
    said = [*faces, *(f"{name} {text}" for name, text in sizes.items())]
    said += [f"turned by {vector(own['angles'])} degrees"] if any(own["angles"]) else []
    said += [f"thickness {own['thickness']:.4g} m", f"{own['stiffness']:.4g} N/m", f"friction {own['friction']:.4g}"]
    kind = "solid plane, as the scene's `planes` says," if own["shape"] == "plane" else own["shape"]
    kind += f" {os.path.basename(own['file'])}" if own.get("file") else ""
    return f"{kind} at {vector(own['centre'])} m: {', '.join(said)}{', moves' if own['moves'] else ''}"


def show_scene(scene: Scene, console: Console) -> None:
    """What belongs to no object."""
    own = whole(scene)
    iterations = counted(scene.newton_iterations, "Newton iteration", "Newton iterations")
    solver = f", {iterations}, tolerance {scene.tolerance:g}" if own["integrator"] in ("implicit", "bdf2") else ""
    console.result(f"{scene.name}: {scene.title!r}: {own['integrator']} steps of {scene.delta:.4g} s{solver}")
    console.result(f"{scene.frames} frames to compare, {own['duration']:.4g} s")
    console.result(f"wind {vector(own['wind'])} m/s, gravity {vector(own['gravity'])} m/s²")
    if own["self_collision"]:
        law = own["self_collision"]
        numbers = f"thickness {law['thickness']:.4g} m, {law['stiffness']:.4g} N/m, friction {law['friction']:.4g}"
        layers = " and each other" if law["between"] and len(scene.cloths) > 1 else ""
        console.result(f"cloths do not pass through themselves{layers}: {numbers}")
    if len(scene.cloths) > 1 and len(scene.groups) == len(scene.cloths):
        console.result("objects do not touch each other")
    spheres = [f"sphere of {each['radius']:.4g} m at {vector(each['centre'])} m" for each in own["spheres"]]
    for kind, lines in (("spheres", spheres), ("colliders", list(map(collider_line, own["colliders"])))):
        console.result(*lines[:MOST_LISTED])
        if len(lines) > MOST_LISTED:
            console.result(f"and {len(lines) - MOST_LISTED} more {kind}")


def column(own: Facts, wanted: Sequence[Flagged]) -> dict[str, str]:
    """An object's cells by the names of their rows."""
    others = own.springs - own.along_edges - own.bending
    parts = ", ".join(map(str, own.parts[:MOST_LISTED])) + (", …" if len(own.parts) > MOST_LISTED else "")
    extent = " × ".join(f"{high - low:.4g}" for low, high in zip(own.low, own.high, strict=True))
    return {
        "vertices": f"{own.vertices}, {own.fixed} fixed",
        "triangles": str(own.triangles),
        "springs": f"{own.springs}: {own.along_edges} along edges, {own.bending} bending, {others} others",
        "parts": f"{len(own.parts)} ({parts} vertices)" + (f", {own.loose} without springs" if own.loose else ""),
        "size": f"{extent} m",
        "lowest corner": f"{vector(own.low)} m",
        "mass": f"{own.mass.total:.4g} kg: {spread(own.mass, 'kg')}",
        "stiffness": spread(own.stiffness, "N/m"),
        "rest length": spread(own.rest, "m") + (" (not those at the start)" if own.strained else ""),
        "velocity": "at the start" if own.moving else "none at the start",
        "damping": f"{own.damping:.4g}",
        "drag": f"{own.drag:.4g}" + (f" (law {own.drag_law})" if own.drag_law != EDITORS else ""),
        "to fit": ", ".join(f"{each.name} ({each.mode}, {each.count})" for each in wanted) or "nothing",
    }


def show_rest(scene: Scene, ahead: Forecast, wanted: Sequence[str], strange: Sequence[str], console: Console) -> None:
    """Stability, what to fit of the scene as a whole, memory, what a subspace would take, and what nobody knows."""
    from clothfit.subspace.break_even import break_even, sentence

    rows = [("integrator", "longest stable step", f"with {scene.delta:.4g} s")]
    for each in ahead.steps:
        longest = "any" if each.limit == float("inf") else f"{each.limit:.3g} s" if each.limit else "none"
        rows.append((each.integrator, longest, "stable" if each.stable else "not stable"))
    console.table(rows)
    if wanted:
        console.result(f"to fit: {', '.join(owned(None, name) for name in wanted)}")
    needed = "" if ahead.fit is None else f", a fit about {human(ahead.fit)}"
    console.result(f"memory: the motion takes {human(ahead.motion)}{needed}; {human(free())} are free")
    if (subspace := break_even(scene)) is not None:
        console.result(sentence(subspace))
    if strange:
        console.result(f"fields that are kept and not used: {', '.join(strange)}")


def spread(values: Spread, unit: str) -> str:
    """How values spread, for people."""
    if values.least is None or values.median is None or values.most is None:
        return "none"
    if values.least == values.most:
        return f"{values.least:.4g} {unit} each"
    return f"{values.least:.4g} … {values.most:.4g} {unit}, half below {values.median:.4g}"
