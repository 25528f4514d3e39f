"""Motions, meshes, forces, checkpoints and logs in numbers: what `clothfit info --json` prints of them."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import doubts
from clothfit.base.messages import counted, metres, spans
from clothfit.cli.common.motions import vector
from clothfit.evaluation.overview import extent
from clothfit.formats.axes import SCAN, Reading

MOST_MESHES = 30
"""Meshes of a file that are looked at."""


def motion(path: str) -> dict[str, Any]:
    """The facts of a motion's file, of any format; lengths in m, times in s. Raises InvalidInput."""
    from clothfit.formats.animation import OtherPoints
    from clothfit.motion import foreign

    try:
        loaded, scan = foreign.load(path, None, Reading()), False
    except OtherPoints:
        loaded, scan = foreign.load(path, None, Reading(bind=SCAN)), True
    own, taken = loaded.motion, loaded.interpretation
    seen: Flags = np.ones(own.positions.shape[:2], bool) if own.observed is None else own.observed
    each = [box(x[some(here)]) for x, here in zip(own.positions, seen, strict=True) if here.any()]  # no second copy
    around = box(np.array([corner for own in each for corner in (own["low"], own["high"])]))
    summary = taken.summary()
    return {
        "kind": "motion",
        "scan": scan,
        **{key: summary[key] for key in ("file", "format", "frames", "points", "duration", "rate", "notes")},
        "fps": summary["fps"] if loaded.timed else None,
        "timed": loaded.timed,
        **{key: summary[key] for key in ("scale", "up", "handedness")},
        "faces": 0 if loaded.triangles is None else len(loaded.triangles),
        **around,
        "first": frame(own.positions[0], seen[0], float(own.times[0])),
        "last": frame(own.positions[-1], seen[-1], float(own.times[-1])),
        "fewest": int(seen.sum(axis=1).min(initial=seen.shape[1])),
        "observed": float(seen.mean()) if seen.size else 0.0,
        "never_observed": int((~seen.any(axis=0)).sum()),
        "travel": None if scan else rms_displacement(own.positions, seen),
        "warnings": doubts(box(own.positions[0][seen[0]])["size"], remedy="read it with estimate --scale {}"),
    }


def some(here: Flags) -> Flags | slice:
    """What picks those points; a view where that is all."""
    return slice(None) if here.all() else here


def box(points: Array) -> dict[str, list[float]]:
    """The two corners of the bounding box of points (n, 3), at the origin where there are none, and its size."""
    around = points.T if len(points) else np.zeros((3, 1))  # row by row, as axis 0 takes several times as long
    low, high = (np.array([end(row) for row in around]) for end in (np.min, np.max))
    return {"low": low.tolist(), "high": high.tolist(), "size": (high - low).tolist()}


def frame(positions: Array, seen: Flags, time: float) -> dict[str, Any]:
    """A frame: its time, its corners, and how many of its points are seen."""
    own = box(positions[seen])
    return {"time": time, "low": own["low"], "high": own["high"], "observed": int(seen.sum())}


def rms_displacement(positions: Array, seen: Flags) -> float:
    """The root mean square distance from frame 0, m, of what is seen in both."""
    both, squares = seen & seen[0], 0.0
    for x, here in zip(positions, both, strict=True):  # without a second copy
        away = x[some(here)] - positions[0, some(here)]
        squares += float(np.vdot(away, away))
    return float(np.sqrt(squares / both.sum())) if both.any() else 0.0


def mesh(path: str) -> dict[str, Any]:
    """The facts of a mesh's file. Raises InvalidInput."""
    from clothfit.meshes.mesh import read_mesh
    from clothfit.meshes.problems import problems

    found, notes = read_mesh(path)
    around = box(found.positions)
    return {
        "kind": "mesh",
        "file": os.path.basename(path),
        "vertices": len(found.positions),
        "triangles": len(found.triangles),
        **around,
        "textured": found.texture is not None,
        "parts": {name: len(vertices) for name, vertices in found.parts},
        "notes": list(notes),
        "problems": [each.sentence for each in problems(found)],
        "warnings": doubts(around["size"], remedy="make its scene with new --scale {}"),
    }


def either(path: str) -> dict[str, Any]:
    """The facts of a file that may have one frame or many, and of each of its meshes. Raises InvalidInput."""
    found = motion(path)
    own = mesh(path) if found["frames"] == 1 and found["faces"] else found
    return own | {"meshes": [] if "*" in path and (found["scan"] or not found["faces"]) else meshes(path)}


def meshes(path: str) -> list[dict[str, Any]]:
    """The facts of the meshes of a file that has names for them, or of the one of a sequence. Raises InvalidInput."""
    from clothfit.formats.animation import short
    from clothfit.formats.registry import foreign, paths
    from clothfit.meshes.mesh import read_shape
    from clothfit.meshes.rigid import held, moves_as

    found = list[dict[str, Any]]()
    for name in ([""] if "*" in path else short(paths(foreign(path), path)))[:MOST_MESHES]:
        try:
            shape = read_shape(path, wanted=name)
        except InvalidInput as error:
            found.append({"name": name, "problem": str(error)})
            continue
        how = moves_as(shape.frames)
        groups = held(shape.frames, shape.mesh.triangles) if how == "moves" else []
        found.append({
            "name": name, "vertices": len(shape.mesh.positions), "faces": len(shape.mesh.triangles),
            "frames": len(shape.frames), "motion": how, "pins": spans_of(shape.pins),
            "held": [{"vertices": spans_of(each.vertices), "moves": each.moves} for each in groups],
        })  # fmt: skip
    return found


def spans_of(vertices: Indices | None) -> str:
    """Vertices as `new --fix-vertices` takes them; empty where there are none."""
    return "" if vertices is None else ",".join(spans(vertices.tolist()))


def mesh_line(own: dict[str, Any]) -> str:
    """A mesh of a file."""
    if "problem" in own:
        return f"{own['name']}: {own['problem']}"
    parts = [counted(own["vertices"], "vertex", "vertices"), counted(own["faces"], "face", "faces"),
             counted(own["frames"], "frame", "frames"), own["motion"]]  # fmt: skip
    parts += [f"pinned {own['pins']}"] if own["pins"] else []
    parts += [f"held? {each['vertices']} ({'as one' if each['moves'] else 'still'})" for each in own["held"]]
    return f"{own['name']}: {', '.join(parts)}" if own["name"] else ", ".join(parts)


def mesh_lines(own: dict[str, Any]) -> dict[str, str]:
    """The row of the meshes of a file, where there are any."""
    lines = [mesh_line(each) for each in own.get("meshes", [])]
    return {"meshes": f"\n{'':<15}".join(lines)} if lines else {}


def forces(path: str) -> dict[str, Any]:
    """The facts of a file of forces; N, s, N/m. Raises InvalidInput."""
    from clothfit.scene.forces import load_forces

    own = load_forces(path, None)
    size = np.linalg.norm(own.values, axis=2)
    row, vertex = np.unravel_index(int(size.argmax()), size.shape)
    lasts = np.append(np.diff(own.times), own.lasts if len(own.times) > 1 else 0.0)
    gain, gains = own.gain, own.regulator
    return {
        "kind": "forces",
        "file": os.path.basename(path),
        "steps": len(own.times),
        "vertices": own.values.shape[1],
        "actuated": int(size.any(axis=0).sum()),
        "begins": float(own.times[0]),
        "duration": float(lasts.sum()),
        "largest": {"force": float(size[row, vertex]), "vertex": int(vertex), "time": float(own.times[row])},
        "effort": float(((size**2).sum(axis=1) * lasts).sum()),
        "springs": None if gain is None else {
            "vertices": int(gain.any(axis=0).sum()), "stiffest": float(gain.max()),
        },
        "regulator": gains and {
            "objects": len(gains.gains), "modes": gains.measure.shape[1], "forces": gains.push.shape[1],
            "bound": gains.bound if np.isfinite(gains.bound) else None,
        },
        "warnings": [],
    }  # fmt: skip


def checkpoint(path: str) -> dict[str, Any]:
    """The facts of a checkpoint. Raises InvalidInput."""
    from clothfit.base.reading import unchanged, whole
    from clothfit.optimise.checkpoint import decoded

    with unchanged(path) as file:
        _, state = decoded(whole(file), os.path.basename(path))
    return {
        "kind": "checkpoint",
        "file": os.path.basename(path),
        "parameters": len(state.best),
        "fitted": len(state.y) or None,
        "cost": state.cost,
        "evaluations": len(state.history),
        "seconds": state.seconds,
        "status": None if state.status is None else str(state.status),
        "model": state.model or None,
        "substeps": state.substeps or None,
        "warnings": list(state.warnings),
    }


def log(path: str) -> dict[str, Any]:
    """The facts of a log of a fit. Raises InvalidInput."""
    from clothfit.report.log import read_log

    found = read_log(path)
    keys = ("scene", "status", "method", "rmse", "evaluations", "seconds", "output")
    return {
        "kind": "log",
        "file": os.path.basename(path),
        "points": len(found.points),
        **{key: found.summary.get(key) for key in keys},
        "finished": bool(found.summary),
        "warnings": list(found.warnings),
    }


# ---- What `clothfit info` prints of motions, meshes, forces, checkpoints and logs: names of rows to their cells.

def motion_rows(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a motion."""
    rate = f", {own['fps']:.6g} a second" if own["fps"] else ""
    timed = f"{own['duration']:.4g} s" if own["timed"] else "no times (--fps)"
    unseen = f", {counted(own['never_observed'], 'point', 'points')} never" if own["never_observed"] else ""
    gaps = "none" if own["observed"] == 1 else f"{100 * (1 - own['observed']):.3g} % of the positions{unseen}"
    faces = counted(own["faces"], "face", "faces") if own["faces"] else "no faces"
    count = str(own["points"]) if own["fewest"] == own["points"] else f"{own['fewest']} to {own['points']}"
    scan = f"{count}, others in each frame: a scan, which is a target of estimate"
    as_motion = {} if own["scan"] else {"travel": f"{metres(own['travel'])} from the first frame (RMS)", "gaps": gaps}
    return {
        "format": own["format"],
        "frames": f"{own['frames']}{rate}, {timed}",
        "points": scan if own["scan"] else f"{own['points']}, {faces}",
        "axes": f"{own['up']} up, {own['handedness']}-handed, {own['scale']:g} m per unit",
        "size": f"{extent(own['size'])} over all frames",
        "first frame": place(own["first"], own["timed"], own["points"]),
        "last frame": place(own["last"], own["timed"], own["points"]),
        **as_motion,
        **({"note": "; ".join(own["notes"])} if own["notes"] else {}),
        **mesh_lines(own),
    }


def place(frame: dict[str, Any], timed: bool, points: int) -> str:
    """Where the points of a frame are, and when."""
    when = f"{frame['time']:.4g} s: " if timed else ""
    seen = "" if frame["observed"] == points else f", {frame['observed']} points seen"
    return f"{when}{vector(frame['low'])} … {vector(frame['high'])} m{seen}"


def mesh_rows(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a mesh."""
    parts = ", ".join(f"{name} ({count})" for name, count in own["parts"].items())
    return {
        "vertices": str(own["vertices"]),
        "triangles": str(own["triangles"]),
        "size": extent(own["size"]),
        "lowest corner": f"{vector(own['low'])} m",
        "texture": "coordinates" if own["textured"] else "none",
        **({"parts": parts} if parts else {}),
        "notes": "; ".join(own["notes"]),
        "problems": "; ".join(own["problems"]) or "none",
        **mesh_lines(own),
    }


def forces_rows(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a file of forces."""
    most, springs, gains = own["largest"], own["springs"], own["regulator"]
    back = []
    if springs:
        count = counted(springs["vertices"], "vertex", "vertices")
        back.append(f"springs of up to {springs['stiffest']:.4g} N/m on {count}")
    if gains:
        bound = "" if gains["bound"] is None else f", no force above {gains['bound']:.4g} N"
        shapes = f"{gains['modes']} modes, {counted(gains['forces'], 'shape', 'shapes')} of forces"
        back.append(f"a regulator in {shapes}{bound}")
    return {
        "steps": f"{own['steps']}, {own['duration']:.4g} s from {own['begins']:.4g} s on",
        "vertices": f"{own['vertices']}, forces on {own['actuated']}",
        "largest force": f"{most['force']:.4g} N on vertex {most['vertex']} at {most['time']:.4g} s",
        "effort": f"{own['effort']:.4g} N² s",
        "feedback": " and ".join(back) or "none",
        "play it": "with simulate --forces" + (", and --feedback" if back else ""),
    }


def checkpoint_rows(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a checkpoint."""
    return {
        "checkpoint": "of a fit; go on with the same command and --resume",
        "parameters": str(own["parameters"]),
        "cost": f"{own['cost']:.4g}",
        "evaluations": f"{own['evaluations']} in {own['seconds']:.4g} s",
        "status": own["status"] or "under way",
    }


def log_rows(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a log."""
    rmse = "" if own["rmse"] is None else f", RMSE {metres(own['rmse'])}"
    return {
        "log": f"of the fit of {own['scene']}" if own["scene"] else "of a fit",
        "points": str(own["points"]),
        "status": f"{own['status']}{rmse}" if own["finished"] else "without its summary: the fit has not ended",
        **({"output": str(own["output"])} if own["output"] else {}),
    }
