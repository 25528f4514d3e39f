"""The content of a page of a cloth on a subspace: its motion over the full one, and beside it, with what both cost.

It has the parts that `contents` lists, where they have a meaning without a fit, and `words` for the two motions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from clothfit.base.messages import metres, percent
from clothfit.evaluation.evaluate import Distance, Evaluation
from clothfit.report.contents import cloth_row, content, vector_rows
from clothfit.report.findings import GOOD, WARN, Cell, table
from clothfit.report.log import Log
from clothfit.report.showing import MOST_POSITIONS, Companion, pictured
from clothfit.subspace.validation import Compared

FULL, BESIDE = "full simulation", "in full"
"""The names of the full motion, over the one on the subspace and beside it."""

WORDS = {"own": "subspace", "goal": FULL, "near": "", "far": ""}

CLOSE = 0.01
"""Error relative to the motion's RMS up to which the verdict is good."""


def subspace_content(over: Compared, model: str) -> dict[str, Any]:
    """Everything that the page shows of a comparison; `model` is the name of the file."""
    scene, found, full = over.scene, over.found, over.full
    whole = Distance(found.frames, found.rmse, found.max_error)
    every = replace(scene, frames=found.frames)  # residuals are those of all frames, not of the fitted ones
    show = pictured(every, scene.delta, over.own, full, Evaluation(whole, whole, []), [], False, MOST_POSITIONS // 3)
    none = Companion(BESIDE, scene, show.target, 0.0 * show.error, 0.0 * show.rmse, 0.0 * show.largest, None)
    until = float(full.times[-1])
    parts = content(scene, scene, replace(show, companions=[none], fitted_until=until), Log(), FULL)
    return parts | {
        "names": {"scene": scene.name, "fitted": model, "target": f"the {FULL} of {scene.name}"},
        "words": WORDS,
        "headline": headline(over),
        "figures": figures(over),
        "facts": facts(over),
        "tables": [*errors(over), *times(over)],
        "remarks": parts["remarks"][:1],
        "blocks": [],
    }


def headline(over: Compared) -> dict[str, Any]:
    """The verdict line, and the warnings under it."""
    found = over.found
    text = f"The subspace follows the full simulation within {percent(found.relative_rmse)} of the motion's RMS."
    if found.forgets:
        parted = found.parted[0].upper() + found.parted[1:]
        text = (f"{parted}: compare how they move, not where they are. Spectra differ by {percent(found.spectrum)}, "
                f"standard deviations of the vertices by {percent(found.deviation)}.")
    warnings = list(found.clamped)
    if found.us_whole >= found.full_us_per_step:
        warnings.append("the subspace does not pay: a frame of it takes longer than a full step")
    return {"level": GOOD if found.relative_rmse <= CLOSE else WARN, "text": text, "warnings": warnings}


def figures(over: Compared) -> list[list[str]]:
    """The figures beside the title."""
    found = over.found
    return [
        ["RMSE", metres(found.rmse)],
        ["of the motion's RMS", percent(found.relative_rmse)],
        ["a frame", f"{found.us_whole:.0f} µs"],
        ["times as fast as full steps", f"{found.full_us_per_step / found.us_whole:.2g}"],
    ]


def facts(over: Compared) -> list[list[str]]:
    """The rows of the summary."""
    found, scene = over.found, over.scene
    vectors = ", ".join(str(part.basis.shape[2]) for part in over.model.parts)
    rows = [
        ["model", f"{over.model.method}, {vectors} vectors, {found.megabytes:.3g} MB"],
        ["largest error", metres(found.max_error)],
        ["drift", f"{metres(found.drift)}, of the mean shape in the last fifth"],
        ["stored energy", f"within {percent(found.energy)}"],
    ]
    names = {"faces": "normals of the faces", "regression": "normals by regression"}
    rows += [[names[name], f"off by {angle:.2g}° in the mean"] for name, angle in found.normals.items()]
    rows += [["spectrum", f"within {percent(found.spectrum)}"],
             ["standard deviations", f"of the vertices within {percent(found.deviation)}"]]
    rows.append(cloth_row(scene))
    rows.append(["time step", f"{1e3 * scene.delta:.4g} ms"])
    return rows + vector_rows(scene)


def errors(over: Compared) -> list[dict[str, Any]]:
    """The error over the horizon, as a table."""
    delta = over.scene.delta
    rows: list[list[Cell]] = [
        [[str(end), end], [f"{(end - 1) * delta:.4g}", (end - 1) * delta], [metres(error), error]]
        for end, error in over.found.over_time
    ]
    return table("horizon", "Error over the horizon", ["frames", "time, s", "RMSE until then"], rows)


def times(over: Compared) -> list[dict[str, Any]]:
    """What a frame costs, as a table."""
    found = over.found
    names = {"regression": "normals by regression"}
    rows: list[list[Cell]] = [[names.get(k, k), micro(value)] for k, value in found.us_per_frame.items()]
    rows += [["a frame", micro(found.us_whole)], ["a full step", micro(found.full_us_per_step)]]
    note = "on one thread; a frame takes the cheaper normals"
    return table("times", "What a frame takes", ["part", "time"], rows, note)


def micro(us: float) -> Cell:
    """A time in µs."""
    return [f"{us:.0f} µs", us]
