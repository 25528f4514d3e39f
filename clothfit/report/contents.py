"""The content of a page: everything that it shows, as one JSON document with packed arrays.

Lengths in m, times in s, masses in kg, stiffnesses in N/m; the page converts units where others suit better. Vertices,
springs and triangles are numbered over all objects, in file order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.messages import counted, metres, owned
from clothfit.base.version import __version__
from clothfit.engine.inputs.sampling import centres_at, winds
from clothfit.evaluation.evaluate import Distance, Evaluation
from clothfit.fabric.fabric import fabric_of, rows_of
from clothfit.objective.identifiability import identifiable
from clothfit.pictures.solids import Solid, solids
from clothfit.report import captures
from clothfit.report.findings import STATUS, began, headline, is_listed, relative, share, tables
from clothfit.report.log import Log, entry, intervals, number
from clothfit.report.packing import box, packed, packed_errors, packed_gaps, packed_positions
from clothfit.report.showing import BEFORE, Companion, View
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene

NO_LOG = "the fit's cost and its 95 % intervals are here where its log is given (estimate --log, report --log)"


def content(
    truth: Scene, fitted: Scene, show: View, log: Log, target: str | None, others: Sequence[Log] = ()
) -> dict[str, Any]:
    """Everything that the page shows of a fitted scene; `target` names the motion it was fitted to, if any, `others`
    are the logs of other fits.
    """
    low, step = box(show.fitted, show.target)
    return {
        "version": __version__,
        "title": truth.title.strip() or truth.name,
        "names": {"scene": truth.name, "fitted": fitted.name, "target": target},
        "headline": headline(log, show, fitted.name),
        "figures": figures(show),
        "facts": facts(truth, fitted, show, log, target),
        "tables": tables(truth, fitted, show, log, others, target is None),
        "notes": show.notes,
        "remarks": [bound(step), *([] if log.points or log.summary else [NO_LOG])],
        "mesh": mesh(fitted),
        "surroundings": surroundings(fitted, show.times, show.fitted),
        "motion": {
            "times": show.times.tolist(),
            "fitted": packed_positions(show.fitted, low, step),
            "target": packed_positions(show.target, low, step),
            "observed": packed_gaps(~np.isnan(show.target[:, :, 0])),
            "error": packed_errors(show.error),
        },
        "curve": {
            "times": show.curve_times.tolist(), "fitted_until": show.fitted_until, "rmse": listed(show.rmse),
            "largest": listed(show.largest),
        },
        "residuals": {
            "mean": [listed(part) for part in show.residuals.mean.T],
            "of_vertices": packed(np.nan_to_num(show.residuals.of_vertices)),
            "known": packed(np.isfinite(show.residuals.of_vertices)),
            "travel": show.residuals.travel,
            **captures.content(show, log.summary),
        },
        "beside": [other(each) for each in show.companions],
        "history": [list(point) for point in log.points],
        "cost_unit": cost_unit(log.summary),
        "blocks": [
            block(each, truth, fitted, log, target is None)
            for each in truth.blocks if not is_listed(each)
        ],
    }  # fmt: skip


def figures(show: View) -> list[list[str]]:
    """The figures beside the title."""
    found = [[f"RMSE, {name}", metres(part.rmse)] for name, part in distances(show.evaluation).items()]
    found.append(["of the distance travelled", share(show.evaluation.fitted.rmse, show)])
    found += [[f"objects[{each.object}] touches {each.other}", each.when] for each in show.touching]
    near = began(show)
    return found if near is None else [*found, [BEFORE, f"{metres(near.rmse)}, {share(near.rmse, show)}"]]


def other(found: Companion) -> dict[str, Any]:
    """A motion beside the fitted one, its errors, and the values that its colours show."""
    low, step = box(found.positions)
    return {
        "name": found.name,
        "fitted": packed_positions(found.positions, low, step),
        "error": packed_errors(found.error),
        "curve": {"rmse": listed(found.rmse), "largest": listed(found.largest)},
        **of_cloths(found.scene, "rest", "mass", "stiffness"),
    }


def cost_unit(summary: Mapping[str, Any]) -> str:
    """The unit of the cost: of squared distances, unless the fit compares other things too."""
    compared = summary.get("objective")
    return "m²" if compared is None or compared == {"position": 1.0} else ""


def listed(values: Array) -> list[float | None]:
    """Numbers with six digits, None for NaN."""
    return [None if np.isnan(x) else float(f"{x:.6g}") for x in values]


def mesh(scene: Scene) -> dict[str, Any]:
    """The mesh of all objects, with the fitted values."""
    starts = np.cumsum([0, *scene.vertex_counts])[:-1]
    cloths = list(zip(scene.cloths, starts, strict=True))

    return {
        "vertex_counts": list(scene.vertex_counts),
        "spring_counts": [len(cloth.stiffness) for cloth in scene.cloths],
        "start": packed(np.concatenate([cloth.positions for cloth in scene.cloths])),
        "triangles": packed(np.concatenate([cloth.triangles.reshape(-1, 3) + first for cloth, first in cloths])),
        "springs": packed(np.concatenate([cloth.springs.reshape(-1, 2) + first for cloth, first in cloths])),
        **of_cloths(scene, "rest", "fixed", "mass", "stiffness"),
    }


def of_cloths(scene: Scene, *fields: str) -> dict[str, Any]:
    """Some fields of all objects, one after another."""
    return {field: packed(np.concatenate([getattr(cloth, field) for cloth in scene.cloths])) for field in fields}


def facts(truth: Scene, fitted: Scene, show: View, log: Log, target: str | None) -> list[list[str]]:
    """The rows of the summary: names and values."""
    rows = [["compared with", "the scene's own motion (a trial)" if target is None else target]]
    for name, part in distances(show.evaluation).items():
        error = f"RMSE {relative(part.rmse, show)}, at most {metres(part.max_error)}"
        rows.append([f"{name}, {part.frames}", error])
    rows += ended(log.summary)
    rows.append(cloth_row(truth))
    for i, cloth in enumerate(fitted.cloths):
        one = len(fitted.cloths) == 1
        rows += [[name if one else owned(i, name), text] for name, text in rows_of(fabric_of(cloth)).items()]
    rows.append(["time step", f"{1e3 * fitted.delta:.4g} ms"])
    return rows + vector_rows(fitted, whole=True)


def cloth_row(scene: Scene) -> list[str]:
    """The row that says how large the cloths of a scene are."""
    size = f"{sum(scene.vertex_counts)} vertices, {sum(len(c.stiffness) for c in scene.cloths)} springs"
    return ["cloth", f"{counted(len(scene.cloths), 'object', 'objects')}, {size}"]


def vector_rows(scene: Scene, whole: bool = False) -> list[list[str]]:
    """The rows of the vectors of the scene as a whole that are not 0, with their lengths where `whole`."""
    offset, rows = ("offset of the colliders", scene.offset, "m"), []
    for name, vector, unit in (("wind", scene.wind, "m/s"), ("gravity", scene.gravity, "m/s²"), offset):
        size = f", {float(np.linalg.norm(vector)):.3g} {unit} in all" if whole else ""
        rows += [[name, f"({', '.join(f'{part:.4g}' for part in vector)}) {unit}{size}"]] if vector.any() else []
    return rows


def distances(evaluation: Evaluation) -> dict[str, Distance]:
    """The distances between the two motions, by the frames they cover; equal ones once."""
    parts = {"fitted frames": evaluation.fitted, "all frames": evaluation.horizon}
    if evaluation.fitted.frames == evaluation.horizon.frames:
        del parts["all frames"]
    return parts


def ended(summary: Mapping[str, Any]) -> list[list[str]]:
    """How the fit ended, as far as that is known."""
    rows = []
    if summary.get("status") in list(STATUS):
        rows.append(["fit", STATUS[summary["status"]]])
    evaluations, seconds, sigma = (number(summary.get(key)) for key in ("evaluations", "seconds", "sigma"))
    if evaluations is not None and seconds is not None:
        rows.append(["took", f"{counted(round(evaluations), 'evaluation', 'evaluations')} in {seconds:.3g} s"])
    rows += captures.registered(summary)
    kept_out = number(entry(summary, "holdout", "rmse"))
    if kept_out is not None and kept_out >= 0:
        still = number(entry(summary, "holdout", "still"))
        beside = "" if still is None else f"; {metres(still)} from the best still picture of the fitted frames"
        rows.append(["kept out of the fit", f"RMSE {metres(kept_out)}{beside}"])
    if sigma is not None and sigma > 0:
        rows.append(["noise", f"{metres(sigma)} per coordinate, where the model is right"])
    return rows


def bound(step: Array) -> str:
    """A remark on how exact the positions in the page are."""
    return f"positions in this page are rounded to {metres(float(step.max()) / 2)} or less; errors are not"


def block(found: Block, truth: Scene, fitted: Scene, log: Log, trial: bool) -> dict[str, Any]:
    """A block of parameters: fitted and given values and intervals, one per element; of vectors the lengths."""
    values, given = (parameters(scene, flags=truth)[found.part] for scene in (fitted, truth))
    shown: Flags = identifiable(truth)[found.part]
    ends = intervals(log.summary, found.cloth, found.name, found.mode, found.count)
    rows = [[np.nan, np.nan] if each is None else each for each in ends or [None] * found.count]
    components, low_high = found.kind.components, np.array(rows, np.float64).reshape(-1, 2)
    if components > 1:  # vectors: the intervals are of components, not of lengths
        values, given = (np.linalg.norm(each.reshape(-1, components), axis=1) for each in (values, given))
        shown = np.asarray(shown.reshape(-1, components).any(axis=1))
        low_high = np.full((len(values), 2), np.nan)
    return {
        "title": found.kind.title.capitalize(),
        "owner": "scene" if found.cloth is None else f"objects[{found.cloth}]",
        "object": found.cloth,
        "mode": found.mode,
        "of": found.kind.of,
        "unit": found.kind.unit if found.name != "rest" or found.mode == "L" else "",
        "log": found.kind.log,
        "trial": trial,
        "values": packed(values),
        "given": packed(given),
        "low": packed(low_high[:, 0]),
        "high": packed(low_high[:, 1]),
        "shown": packed(shown),
    }


def surroundings(scene: Scene, times: Array, x: Array) -> dict[str, Any]:
    """All of it, for a motion x (F, n, 3), m, at times (F,), s."""
    paths = np.moveaxis(centres_at(scene, times), 1, 0)
    return {
        "wind": scene.wind.tolist(),
        **({"gusts": winds(scene, times).tolist()} if scene.wind_keys else {}),
        "spheres": [
            {"centre": sphere.centre.tolist(), "radius": sphere.radius}
            | ({"path": path.tolist()} if sphere.position else {})
            for path, sphere in zip(paths, scene.spheres, strict=True)
        ],
        "solids": [solid(each) for each in solids(scene, times, x)],
        "pinned": any(cloth.pins for cloth in scene.cloths),
    }


def solid(found: Solid) -> dict[str, Any]:
    """A collider in triangles: where its axes are at the start, or at each frame, as a place and a quaternion, and in
    them the paths of points that go their own ways.
    """
    from scipy.spatial.transform import Rotation

    count = len(found.centre) if found.moves else 1
    turns = Rotation.from_matrix(found.turn[:count]).as_quat()
    paths = {} if found.paths is None else {"paths": packed_positions(found.paths, *box(found.paths))}
    return {
        **paths,
        "points": packed(found.points),
        "triangles": packed(found.triangles),
        "tone": packed(found.tone),
        "places": found.centre[:count].tolist(),
        "turns": turns.tolist(),
        "endless": found.endless,
    }
