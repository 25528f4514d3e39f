"""What a reader should know first: how good the fit is, in a line, and what to be wary of.

From the fit's summary, which is not checked, as far as it is known, and from the motions themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from clothfit.base.messages import counted, metres, owned
from clothfit.evaluation.evaluate import Distance
from clothfit.fit.verdict import ADEQUATE, DIFFERS
from clothfit.optimise.status import Status
from clothfit.report.log import Log, entry, number, records
from clothfit.report.showing import BEFORE, Shown

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


def headline(log: Log, show: Shown) -> dict[str, Any]:
    """The verdict line: its level, which gives its colour, and its text; and the warnings under it."""
    level, text = judged(log.summary)
    ended = log.summary.get("status")
    if ended in list(STATUS) and ended != Status.CONVERGED:
        level, text = WARN, f"{text} The fit {STATUS[ended]}."
    if show.evaluation.diverged:
        level, text = WARN, "The motion diverges."
    error = f"{text} Error {relative(show.evaluation.fitted.rmse, show)}{before(show)}."
    return {"level": level, "text": error.strip(), "warnings": list(dict.fromkeys(warnings(log, show)))}


def judged(summary: Mapping[str, Any]) -> tuple[str, str]:
    """The level of the fit's verdict on its model, and what it says."""
    left, model = number(entry(summary, "verdict", "unexplained")), entry(summary, "verdict", "model")
    if left is not None and model == DIFFERS:
        return WARN, f"The model differs from the target: {percent(left)} of the motion is unexplained."
    if left is not None and model == ADEQUATE:
        return GOOD, "The fit explains the target: what is left is noise or rounding."
    return PLAIN, ""


def relative(rmse: float, show: Shown) -> str:
    """An error with its part of the distance that the target goes."""
    travel = show.residuals.travel
    if travel <= 0 or rmse / travel < INVISIBLE:
        return f"{metres(rmse)}, " + ("below 0.001 % of the travel" if travel > 0 else "of a target that stands still")
    return f"{metres(rmse)}, {percent(rmse / travel)} of the travel"


def share(rmse: float, show: Shown) -> str:
    """An error in percent of the distance that the target goes."""
    travel = show.residuals.travel
    if travel <= 0:
        return "–"
    return percent(rmse / travel) if rmse / travel >= INVISIBLE else "< 0.001 %"


def before(show: Shown) -> str:
    """How large the error was before the fit, as far as that is known."""
    found = began(show)
    return "" if found is None else f"; before the fit {metres(found.rmse)}, {share(found.rmse, show)}"


def began(show: Shown) -> Distance | None:
    """The error before the fit; None where it is not known."""
    return next((each.near for each in show.beside if each.name == BEFORE), None)


def percent(fraction: float) -> str:
    """A fraction in percent with two digits."""
    return f"{100 * fraction:.2g} %" if fraction < 1 else f"{100 * fraction:.0f} %"


def warnings(log: Log, show: Shown) -> Iterator[str]:
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
        kinds = {"at_bound": "at a bound of the fit (--bounds)", "unidentifiable": "not shown by the motion"}
        for key, text in kinds.items():
            found = block.get(key)
            if isinstance(found, list) and found:
                yield f"{name}: {counted(len(found), 'value is', 'values are')} {text}"
