"""The content of a page of a controlled motion: the cloths, that motion without the controls, keys, forces.

It has the parts that `contents` lists, where they have a meaning without a target, and under `control` what the page
draws of keys and forces.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.messages import counted, metres
from clothfit.base.version import __version__
from clothfit.control.control import Control, ControlledMotion, away
from clothfit.control.keyframes import Key
from clothfit.optimise.status import Status
from clothfit.pictures.stage import good_frames
from clothfit.report.contents import bound, cloth_row, listed, mesh, other, surroundings, vector_rows
from clothfit.report.findings import GOOD, STATUS, WARN, Cell, table
from clothfit.report.packing import box, packed_errors, packed_flags, packed_gaps, packed_positions
from clothfit.report.showing import MOST_POSITIONS, Companion
from clothfit.scene.scene import Scene

WITHOUT = "without control"
"""The name of the motion beside the controlled one."""

MOST_GHOSTS = 100_000
"""Most positions of keys whose vertices are drawn; of more keys every k-th one is, the last among them."""


def control_content(over: ControlledMotion, found: Control) -> dict[str, Any]:
    """Everything that the page shows of a course, which a search has found."""
    scene, frames = over.scene, page_frames(over)
    times, own = over.times[frames], over.own[frames]
    low, step = box(own)
    notes = [] if len(frames) == len(over.times) else ["not every frame is shown, as all would make this page large; "
                                                      "the charts know all"]  # fmt: skip
    return {
        "version": __version__,
        "title": scene.title.strip() or scene.name,
        "names": {"scene": scene.name, "fitted": scene.name, "target": None},
        "headline": headline(found),
        "figures": figures(found),
        "facts": facts(over, found),
        "tables": table("keys", "Keys", *keys_table(over, found)),
        "notes": notes,
        "remarks": [bound(step), *notes],
        "mesh": mesh(scene),
        "surroundings": surroundings(scene, times, own),
        "motion": {
            "times": times.tolist(),
            "fitted": packed_positions(own, low, step),
            "observed": packed_gaps(~np.isnan(wanted(over, frames)[:, :, 0])),
            "error": packed_errors(errors(over, own, frames)),
        },
        "curve": {"times": times.tolist(), "rmse": listed(nearness(over, over.own)[frames])},
        "beside": [without(over, scene, frames)],
        "history": [],
        "blocks": [],
        "control": drawn(over, frames),
    }  # fmt: skip


def page_frames(over: ControlledMotion) -> Indices:
    """Which frames the page shows: every k-th where there are many, and those of keys."""
    every = max(-(-3 * over.own.shape[0] * over.own.shape[1] // MOST_POSITIONS), 1)
    chosen = np.concatenate([np.arange(0, len(over.times), every), over.due, [len(over.times) - 1]])
    return np.unique(chosen).astype(np.int32)


def drawn(over: ControlledMotion, frames: Indices) -> dict[str, Any]:
    """Keys, forces and paths of pins as the page draws them, and the lines of its charts."""
    every = max(-(-over.poses.shape[0] * over.poses.shape[1] // MOST_GHOSTS), 1)
    last = len(over.due) - 1
    kept = [k for k in range(len(over.due)) if (last - k) % every == 0]
    asked = ~np.isnan(over.poses[kept][:, :, 0])
    poses = np.where(asked[:, :, None], over.poses[kept], over.own[over.due[kept]])
    forces = over.forces[frames]
    strength = np.linalg.norm(over.forces, axis=2).max(axis=1)
    return {
        "times": over.times[over.due].tolist(),
        "due": np.searchsorted(frames, over.due).tolist(),
        "ghosts": kept,
        "poses": packed_positions(poses, *box(poses)),
        "asked": packed_flags(asked),
        "means": [places.tolist() for places in over.means],
        "forces": packed_positions(forces, *box(forces)),
        "largest": float(strength.max()),
        "handles": handles(over, frames),
        "chart": {
            "times": over.times.tolist(),
            "distances": [listed(values) for values in over.distance],
            "at": [key.step for key in over.keys],
            "names": [what(key, over.scene, short=True) for key in over.keys],
            "effort": listed(over.effort),
            "force": listed(strength),
        },
    }


def handles(over: ControlledMotion, frames: Indices) -> list[Any]:
    """Of each pin that moves the path (F, 3) of the mean of its vertices."""
    found = []
    for number, cloth in enumerate(over.scene.cloths):
        x = over.own[frames][:, over.scene.vertices(number)]
        found += [np.round(x[:, pin.vertices].mean(axis=1), 6).tolist() for pin in cloth.pins]
    return found


def wanted(over: ControlledMotion, frames: Indices) -> Array:
    """At each frame (F, n, 3) what the next key asks for, m; NaN where it asks for nothing."""
    return over.poses[[over.next(int(frame)) for frame in frames]]


def errors(over: ControlledMotion, x: Array, frames: Indices) -> Array:
    """The distances (F, n), m, of positions x (F, n, 3) from the next key."""
    return np.asarray(np.linalg.norm(x - wanted(over, frames), axis=2))


def nearness(over: ControlledMotion, x: Array) -> Array:
    """The distance (F,), m, of a motion x (F, n, 3) from what the next key asks for; of several keys the largest."""
    far = np.array([away(key, x[:, over.scene.vertices(key.cloth)]) for key in over.keys])
    step = np.array([key.step for key in over.keys])
    due = over.due[[over.next(frame) for frame in range(len(x))]]
    return np.asarray(np.where(step[:, None] == due, far, 0.0).max(axis=0))


def without(over: ControlledMotion, scene: Scene, frames: Indices) -> dict[str, Any]:
    """The motion without the controls; where it leaves the picture it stays."""
    free, good = over.free.copy(), good_frames(over.free)
    free[good:] = free[good - 1]
    far, none = nearness(over, free)[frames], np.full(len(frames), np.nan)
    return other(Companion(WITHOUT, scene, free[frames], errors(over, free[frames], frames), far, none, None))


def headline(found: Control) -> dict[str, Any]:
    """The verdict line, and the warnings under it."""
    far = [key for key in found.keys if not key.near]
    count = {1: "the key", 2: "both keys"}.get(len(found.keys), f"all {len(found.keys)} keys")
    text = f"The cloth passes through {count}."
    if far:
        worst = max(far, key=lambda key: key.rmse)
        missed = f"{len(far)} of {len(found.keys)} keys are missed" if len(found.keys) > 1 else "The key is missed"
        text = f"{missed}, at {worst.time:.4g} s by {metres(worst.rmse)}."
    ended = found.status == Status.CONVERGED
    text += "" if ended else f" The search {STATUS[found.status]}."
    bounds = [f"{counted(found.at_bound, 'force is', 'forces are')} at the bound (--most)"] if found.at_bound else []
    return {"level": WARN if far or not ended else GOOD, "text": text, "warnings": bounds}


def figures(found: Control) -> list[list[str]]:
    """The figures beside the title."""
    return [
        ["effort", f"{found.effort:.4g} N² s"],
        ["farthest from a key", metres(max(key.rmse for key in found.keys))],
        [WITHOUT, metres(max(found.free))],
    ]


def facts(over: ControlledMotion, found: Control) -> list[list[str]]:
    """The rows of the summary."""
    strength, scene = np.linalg.norm(over.forces, axis=2), over.scene
    pushed = int(strength.any(axis=0).sum())
    step, vertex = np.unravel_index(int(strength.argmax()), strength.shape)
    rows = [
        ["search", STATUS[found.status]],
        ["took", f"{counted(found.evaluations, 'evaluation', 'evaluations')} in {found.seconds:.3g} s"],
        ["optimality", f"{found.optimality:.3g} of the gradient at the start is left"],
    ]
    if strength.any():
        where = f"vertex {vertex} at {over.times[step]:.4g} s"
        rows.append(["forces", f"on {counted(pushed, 'vertex', 'vertices')}, at most {strength.max():.4g} N: {where}"])
    pins = sum(len(cloth.pins) for cloth in scene.cloths)
    rows += [["handles", counted(pins, "path of pins", "paths of pins")]] if pins else []
    rows.append(cloth_row(scene))
    rows.append(["time", f"{over.times[-1]:.4g} s in {len(over.times) - 1} steps of {1e3 * scene.delta:.4g} ms"])
    return rows + vector_rows(scene)


def keys_table(over: ControlledMotion, found: Control) -> tuple[list[str], list[tuple[Cell, ...]], str]:
    """Heads, rows and note of the table of keys."""
    near = found.keys
    columns: dict[str, list[Cell]] = {
        "key": [[f"{key.time:.4g}\u00a0s", key.time] for key in near],
        "asks for": [what(key, over.scene) for key in over.keys],
        "without": [[metres(far), far] for far in found.free],
        "with": [[metres(key.rmse), key.rmse] for key in near],
        "reached": ["yes" if key.near else "missed" for key in near],
    }
    if any(key.speed is not None for key in near):
        columns["velocity off"] = ["–" if key.speed is None else [f"{key.speed:.3g} m/s", key.speed] for key in near]
    if any(key.hard or key.weight != 1.0 for key in over.keys):
        columns["weight"] = ["hard" if key.hard else [f"{key.weight:.4g}", key.weight] for key in over.keys]
    rows = list(zip(*columns.values(), strict=True))
    return list(columns), rows, "root mean square distances, without and with control"


def what(key: Key, scene: Scene, short: bool = False) -> str:
    """What a key asks for, in words."""
    part = "" if len(scene.cloths) == 1 else f" of objects[{key.cloth}]"
    count, every = len(key.vertices), scene.vertex_counts[key.cloth]
    if key.share is not None:
        text = f"mean of {count}" if not short else "mean"
    else:
        text = ("all" if count == every else f"{count} of {every}") + ("" if short else " vertices")
    return f"{key.step * scene.delta:.4g} s, {text}{part}" if short else f"{text}{part}"
