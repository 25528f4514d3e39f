"""What a reader should know first: how good the fit is, in a line, and what to be wary of; and the tables of a page:
values at the start, fitted and true; models and time steps that were tried; fits side by side.

From the fit's summary, which is not checked, as far as it is known, and from the motions themselves. A table is {id,
title, heads, rows, note}; a cell is the text that is shown, or [text, number], where a spreadsheet is to have the
number.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import counted, metres, owned, percent
from clothfit.evaluation.evaluate import Distance
from clothfit.fit.result import ADEQUATE, DIFFERS, FAILS, HARDLY
from clothfit.optimise.status import Status
from clothfit.report import captures
from clothfit.report.log import Log, entry, intervals, number, records
from clothfit.report.showing import BEFORE, View
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import parameters
from clothfit.scene.kinds import AUTO, MODEL_NAMES
from clothfit.scene.scene import Scene

STATUS = {
    Status.CONVERGED: "converged",
    Status.STALLED: "stalled before its tolerance",
    Status.LIMIT: "ended at its limit; the best so far",
    Status.INTERRUPTED: "interrupted; the best so far",
}
"""How a fit ended, as text; any other status in a log is ignored."""

GOOD, WARN, PLAIN = "good", "warn", "plain"
INVISIBLE = 1e-5
"""Error relative to the travel below which its percentage says nothing."""

MANY = 8  # of hints and warnings in the summary that are shown


def headline(log: Log, show: View, fitted: str = "FITTED") -> dict[str, Any]:
    """The verdict line: its level, which gives its colour, and its text; what to do next with the `fitted` file; and
    the warnings under it.
    """
    level, text = judged(log.summary)
    ended = log.summary.get("status")
    if ended in list(STATUS) and ended != Status.CONVERGED:
        level, text = WARN, f"{text} The fit {STATUS[ended]}."
    if show.evaluation.diverged:
        level, text = WARN, "The motion diverges."
    error, near = f"{text} Error {relative(show.evaluation.fitted.rmse, show)}", began(show)
    error += "." if near is None else f"; before the fit {metres(near.rmse)}, {share(near.rmse, show)}."
    said = list(dict.fromkeys(warnings(log, show)))
    return {"level": level, "text": error.strip(), "next": advice(log.summary, fitted), "warnings": said}


def advice(summary: Mapping[str, Any], fitted: str) -> str:
    """What a user can do next; nothing where the summary does not say how the fit ended."""
    model, cache = entry(summary, "verdict", "model"), f"clothfit simulate {fitted} -o cloth.pc2"
    said = {str(each.get("code")): each.get("text") for each in records(summary, "hints")}
    if summary.get("status") in (Status.LIMIT, Status.INTERRUPTED):
        return "Go on from here with --resume, or with a longer --budget."
    if model == FAILS:
        more = "" if AUTO in said else ", then let the fit choose what moves the cloth: --fit auto"
        return f"Check unit, axes and held vertices{more}."
    if model == DIFFERS:
        more = said.get("stalled") or ("" if AUTO in said else "free more: --fit auto, --model auto")
        text = f"{more}; or use the fitted motion as it is: {cache}" if more else f"use the fitted motion: {cache}"
        return text[0].upper() + text[1:]
    values = f"clothfit export {fitted} --to blender"
    return f"Play it on your mesh: {cache}; or take its values: {values}" if model == ADEQUATE else ""


def judged(summary: Mapping[str, Any]) -> tuple[str, str]:
    """The level of the fit's verdict on its model, and what it says."""
    left, model = number(entry(summary, "verdict", "unexplained")), entry(summary, "verdict", "model")
    if left is not None and model == DIFFERS:
        return WARN, f"The model differs from the target: {percent(left)} of the motion is unexplained."
    if left is not None and model == FAILS:
        return WARN, f"The fit fails, leaving more than it explains: {percent(left)} of the motion."
    if left is not None and model == ADEQUATE:
        return GOOD, "The fit explains the target: what is left is noise or rounding."
    return PLAIN, ""


def relative(rmse: float, show: View) -> str:
    """An error with its part of the distance that the target goes."""
    travel = show.residuals.travel
    if travel <= 0 or rmse / travel < INVISIBLE:
        return f"{metres(rmse)}, " + ("below 0.001 % of the travel" if travel > 0 else "of a target that stands still")
    return f"{metres(rmse)}, {percent(rmse / travel)} of the travel"


def share(rmse: float, show: View) -> str:
    """An error in percent of the distance that the target goes."""
    travel = show.residuals.travel
    if travel <= 0:
        return "–"
    return percent(rmse / travel) if rmse / travel >= INVISIBLE else "< 0.001 %"


def began(show: View) -> Distance | None:
    """The error before the fit; None where it is not known."""
    return next((each.near for each in show.companions if each.name == BEFORE), None)


def warnings(log: Log, show: View) -> Iterator[str]:
    """What to be wary of, the most important first."""
    summary = log.summary
    yield from show.notes
    yield from blocks(summary)
    hints = summary.get("hints")
    for hint in (hints if isinstance(hints, list) else [])[:MANY]:
        if isinstance(hint, Mapping) and isinstance(hint.get("text"), str) and hint.get("code") != "bounds":
            yield f"hint: {hint['text']}"
    given = summary.get("warnings")
    yield from (text for text in (given if isinstance(given, list) else [])[:MANY] if isinstance(text, str))
    yield from log.warnings


def blocks(summary: Mapping[str, Any]) -> Iterator[str]:
    """What is to be said of single values: those at a bound, and those that the motion does not show."""
    for block in records(summary, "parameters"):
        if not isinstance(block.get("name"), str):
            continue
        place = block.get("object")
        name = owned(place if isinstance(place, int) else None, block["name"])
        kinds = {"at_bound": "at a bound of the fit (--bounds)", "unidentifiable": "not shown by the motion",
                 "hardly_shown": f"hardly shown by it, to a factor of {HARDLY:g} or worse"}
        for key, text in kinds.items():
            found = block.get(key)
            if isinstance(found, list) and found:
                yield f"{name}: {counted(len(found), 'value is', 'values are')} {text}"
        least = [number(each) for each in block.get("least") or []] if block.get("at_least") is True else []
        if known := sorted(each for each in least if each is not None):
            ends = dict.fromkeys(written(each, 3) for each in (known[0], known[-1]))
            yield f"{name}: at least {' to '.join(ends)} N/m where edges hardly stretch"


Cell: TypeAlias = str | list[Any]
Table: TypeAlias = dict[str, Any]

FEW, FEW_GROUPS = 3, 12
"""Blocks of up to so many values, or factors of groups, have a row for each, others one for their median."""

MOST_ROWS = 40
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

ONLY = "the intervals are for this model only: no test finds what acts just as the fitted values do"

MARKERS = "distances from the fitted motion in the shown frames; those that were mistaken first, then the farthest"


def table(name: str, title: str, heads: list[str], rows: Sequence[Sequence[Cell]], note: str = "") -> list[Table]:
    """A table, if it has rows."""
    found = {"id": name, "title": title, "heads": heads, "rows": [list(row) for row in rows], "note": note}
    return [found] if rows else []


def tables(truth: Scene, fitted: Scene, show: View, log: Log, others: Sequence[Log], trial: bool) -> list[Table]:
    """All tables of a page; `others` are the logs of the other fits, empty ones where there are none."""
    return [
        *side_by_side(truth, fitted, show, [log, *others]),
        *values_table(truth, fitted, log, trial),
        *model_table(log.summary),
        *steps(log.summary),
        *table("markers", "Markers", captures.heads(show), captures.table_rows(show, log.summary), MARKERS),
        *correlations(log.summary),
    ]


def values_table(truth: Scene, fitted: Scene, log: Log, trial: bool) -> list[Table]:
    """Each value, or the median of many: at the start, fitted, true in a trial, and its 95 % interval."""
    rows = [row for block in truth.blocks for row in value_rows(block, truth, fitted, log, trial)]
    heads = list(rows[0]) if rows else []
    title = "Start, fitted" + (", truth" if trial else "")
    return table("values", title, heads, [list(row.values()) for row in rows], scope(log.summary))


def scope(summary: Mapping[str, Any]) -> str:
    """What the intervals hold for, and where they are by samples, how accurate they are; empty without a verdict."""
    model = entry(summary, "verdict", "model")
    texts = ["the intervals are not certain, as the model differs" if model == DIFFERS else ONLY]
    found: list[Any] = [number(entry(summary, "samples", key)) for key in ("count", "accuracy")]
    if None not in found:
        texts.append("they are by {:.0f} samples of the posterior, to {:.0%}".format(*found))
    return "; ".join(texts) if model in (ADEQUATE, DIFFERS) else ""


def value_rows(block: Block, truth: Scene, fitted: Scene, log: Log, trial: bool) -> Iterator[dict[str, Cell]]:
    """The rows of one block, by the heads of their columns."""
    scenes = {"start": log.start, "fitted": fitted, "truth": truth if trial else None}
    found = {head: parameters(each, flags=truth)[block.part] for head, each in scenes.items() if each is not None}
    ends = intervals(log.summary, block.cloth, block.name, block.mode, block.count) or [None] * block.count
    unit = "factor" if block.factors is not None or (block.name == "rest" and block.mode != "L") else block.kind.unit
    name = owned(block.cloth, block.kind.title)
    if is_listed(block):
        for i, label in enumerate(labels(block)):
            cells = {head: figure(values[i]) for head, values in found.items()}
            cells |= {"off by": off(found["fitted"][i], found["truth"][i])} if trial else {}
            yield {"value": f"{name} {label}".strip(), **cells, "95 % interval": interval(ends[i]), "unit": unit}
        return
    cells = {head: figure(median(values)) for head, values in found.items()}
    if trial:
        with np.errstate(divide="ignore", invalid="ignore"):
            gaps = np.abs(found["fitted"] / found["truth"] - 1.0)
        gap = median(gaps[np.isfinite(gaps)]) if np.isfinite(gaps).any() else np.nan
        cells["off by"] = [f"{written(100 * gap, 2)} %", gap] if np.isfinite(gap) else "–"
    pairs = [each for each in ends if each]
    half = f"± {written(median([high - low for low, high in pairs]) / 2)}" if pairs else "–"
    yield {"value": f"{name}, median of {block.count}", **cells, "95 % interval": half, "unit": unit}


def is_listed(block: Block) -> bool:
    """Whether each value of a block has a row of its own; otherwise it has a card with charts."""
    return block.count <= (FEW if block.factors is None else FEW_GROUPS)


def labels(block: Block) -> list[str]:
    """What tells the values of a block apart: components, groups, or indices."""
    if block.factors is not None:
        names = list(block.factors.names)
        return names if len(names) == block.count else [f"[{i}]" for i in range(block.count)]
    if block.kind.components == block.count:
        return ["x", "y", "z"] if block.count == 3 else [""]
    return [f"[{i}]" for i in range(block.count)]


def figure(value: float) -> Cell:
    """A number as text, and itself; only the text of what is not finite."""
    return [written(value), float(value)] if np.isfinite(value) else f"{value:.5g}"


def written(value: float, digits: int = 5) -> str:
    """A number with so many digits, very small and large ones with a power of ten."""
    text, power = f"{value:.{digits}g}".partition("e")[::2]
    return f"{text} × 10{str(int(power)).translate(RAISED)}" if power else text


def median(values: Array | Sequence[float]) -> float:
    """The median; inf where it is too large for a number."""
    with np.errstate(over="ignore"):
        return float(np.median(values))


def off(value: float, true: float) -> Cell:
    """How far a value is from the true one, relative to it; of 0 in its unit."""
    if true == 0:
        return written(value, 2)
    gap = abs(value / true - 1.0)
    return [f"{written(100 * gap, 2)} %", float(gap)] if np.isfinite(gap) else "–"


def interval(ends: Any) -> str:
    """An interval as text."""
    return "–" if not ends else f"{written(ends[0])} … {written(ends[1])}"


def length(value: object) -> Cell:
    """A length of a summary, in m."""
    found = number(value)
    return "–" if found is None or found < 0 else [metres(found), found]


def plain(value: object, digits: int = 3) -> Cell:
    """A number of a summary."""
    found = number(value)
    return "–" if found is None else [written(found, digits), found]


def model_table(summary: Mapping[str, Any]) -> list[Table]:
    """The models that were fitted, from coarse to fine."""
    rows: list[list[Cell]] = []
    for each in records(summary, "ladder")[:MOST_ROWS]:
        model = each.get("model")
        if not isinstance(model, str) or model not in MODEL_NAMES:
            continue
        figures = plain(each.get("values"), 9), length(each.get("rmse")), length(each.get("holdout_rmse"))
        rows.append([f"{model} {MODEL_NAMES[model]}", *figures, plain(each.get("seconds"))])
    heads = ["model", "values", "error", "held-out error", "seconds"]
    note = "from coarse to fine; a model with more values should be nearer on what was kept out, too"
    return table("ladder", "Models that were tried", heads, rows, note)


def steps(summary: Mapping[str, Any]) -> list[Table]:
    """The time steps that were tried."""
    rows: list[list[Cell]] = [
        [plain(each.get("substeps"), 9), str(each.get("integrator"))[:20], length(each.get("rmse")),
         plain(each.get("seconds"))]
        for each in records(summary, "step", "tried")[:MOST_ROWS]
    ]  # fmt: skip
    note = "steps to a frame of the target, with the error of the coarsest model"
    return table("steps", "Time steps that were tried", ["steps", "integrator", "error", "seconds"], rows, note)


def correlations(summary: Mapping[str, Any]) -> list[Table]:
    """The values that are hard to tell apart."""
    rows: list[list[Cell]] = []
    for each in records(summary, "correlations")[:MOST_ROWS]:
        pair = [each.get("first"), each.get("second")]
        if all(isinstance(value, Mapping) for value in pair):
            rows.append([*(value_name(value) for value in pair), plain(each.get("correlation"))])
    note = (
        "correlation of the errors of two values: near 1 or −1 the motion shows a combination of them better than each "
        "alone"
    )
    return table("correlations", "Hard to tell apart", ["value", "and", "correlation"], rows, note)


def value_name(value: Any) -> str:
    """One fitted value of a summary."""
    place, index = value.get("object"), value.get("index")
    name = owned(place if isinstance(place, int) else None, str(value.get("name"))[:40])
    if not isinstance(index, int):
        return name
    return f"{name} {'xyz'[index % 3]}" if place is None else f"{name} [{index}]"


def side_by_side(truth: Scene, fitted: Scene, show: View, logs: Sequence[Log]) -> list[Table]:
    """The motions of a page beside each other, where there are several: errors, and the median of each block."""
    if not show.companions:
        return []
    blocks = [each for each in truth.blocks if each.count == 1 or each.kind.components == 1]
    scenes = [(fitted.name, fitted, show.evaluation.fitted), *((b.name, b.scene, b.near) for b in show.companions)]
    fits = [name for name, *_ in scenes if name != BEFORE]
    known = dict(zip(fits, logs, strict=False))
    rows: list[list[Cell]] = []
    for name, scene, near in scenes:
        far = ["diverges", "–", "–"] if near is None else [
            [metres(near.rmse), near.rmse], [share(near.rmse, show), near.rmse / (show.residuals.travel or np.inf)],
            [metres(near.max_error), near.max_error],
        ]  # fmt: skip
        medians = [figure(median(parameters(scene, flags=truth)[block.part])) for block in blocks]
        took = plain(known[name].summary.get("seconds")) if name in known else "–"
        rows.append([name, *far, *medians, took])
    named = [owned(b.cloth, b.kind.title) + (" factor" if b.factors is not None else "") for b in blocks]
    named = [f"{name} (median)" if b.count > 1 else name for name, b in zip(named, blocks, strict=True)]
    heads = ["motion", "RMSE", "of travel", "largest", *named, "seconds"]
    return table("fits", "Side by side", heads, rows, "over the fitted frames")
