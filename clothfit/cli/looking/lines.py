"""What `clothfit info` prints of motions, meshes, forces, checkpoints and logs: names of rows to their cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothfit.base.messages import counted, metres
from clothfit.inspection.doubts import extent


def motion(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a motion."""
    rate = f", {own['fps']:.6g} a second" if own["fps"] else ""
    timed = f"{own['duration']:.4g} s" if own["timed"] else "no times (--fps)"
    unseen = f", {counted(own['never_observed'], 'point', 'points')} never" if own["never_observed"] else ""
    gaps = "none" if own["observed"] == 1 else f"{100 * (1 - own['observed']):.3g} % of the positions{unseen}"
    return {
        "format": own["format"],
        "frames": f"{own['frames']}{rate}, {timed}",
        "points": f"{own['points']}, {counted(own['faces'], 'face', 'faces') if own['faces'] else 'no faces'}",
        "axes": f"{own['up']} up, {own['handedness']}-handed, {own['scale']:g} m per unit",
        "size": f"{extent(own['size'])} over all frames",
        "first frame": place(own["first"], own["timed"], own["points"]),
        "last frame": place(own["last"], own["timed"], own["points"]),
        "travel": f"{metres(own['travel'])} from the first frame (RMS)",
        "gaps": gaps,
        **({"note": "; ".join(own["notes"])} if own["notes"] else {}),
    }


def place(frame: dict[str, Any], timed: bool, points: int) -> str:
    """Where the points of a frame are, and when."""
    when = f"{frame['time']:.4g} s: " if timed else ""
    seen = "" if frame["observed"] == points else f", {frame['observed']} points seen"
    return f"{when}{vector(frame['low'])} … {vector(frame['high'])} m{seen}"


def mesh(own: dict[str, Any]) -> dict[str, str]:
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
    }


def forces(own: dict[str, Any]) -> dict[str, str]:
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


def checkpoint(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a checkpoint."""
    return {
        "checkpoint": "of a fit; go on with the same command and --resume",
        "parameters": str(own["parameters"]),
        "cost": f"{own['cost']:.4g}",
        "evaluations": f"{own['evaluations']} in {own['seconds']:.4g} s",
        "status": own["status"] or "under way",
    }


def log(own: dict[str, Any]) -> dict[str, str]:
    """The rows of a log."""
    rmse = "" if own["rmse"] is None else f", RMSE {metres(own['rmse'])}"
    return {
        "log": f"of the fit of {own['scene']}" if own["scene"] else "of a fit",
        "points": str(own["points"]),
        "status": f"{own['status']}{rmse}" if own["finished"] else "without its summary: the fit has not ended",
        **({"output": str(own["output"])} if own["output"] else {}),
    }


def vector(values: Sequence[float]) -> str:
    """Three components, for people; -0 is 0."""
    return f"({', '.join(f'{value + 0.0:.4g}' for value in values)})"
