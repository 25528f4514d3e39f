"""What `clothfit estimate` prints of many scenes at its end: a table, or objects for scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clothfit.base.errors import ClothfitError
from clothfit.base.messages import metres
from clothfit.cli.common import motions
from clothfit.cli.fitting import outcomes
from clothfit.cli.fitting.plan import Item
from clothfit.many.estimate_many import Result
from clothfit.many.job import Outcome

FIT_COLUMNS = ("scene", "start", "status", "RMSE", "frames", "evaluations", "seconds", "output")
START_COLUMN = FIT_COLUMNS.index("start")


def rows(items: Sequence[Item], results: Sequence[Result], errors: Mapping[int, ClothfitError]) -> list[list[str]]:
    """A row for each scene and start, in the order of the arguments, below a header."""
    found = [list(FIT_COLUMNS)]
    for index, (item, result) in enumerate(zip(items, results, strict=True)):
        for number, outcome in enumerate(result.outcomes):
            error = errors.get(index) or outcome.error
            best = number == result.best and outcome.usable
            output = item.out.name if item.out and best else ""
            place = f"error: {error}" if error and outcome.status != "not started" else output
            found.append([item.path if number == 0 else "", str(number + 1), *figures(outcome), place])
    if all(len(result.outcomes) == 1 for result in results):
        return [row[:START_COLUMN] + row[START_COLUMN + 1 :] for row in found]
    return found


def figures(outcome: Outcome) -> tuple[str, ...]:
    """The middle of a row: status, RMSE, frames, evaluations, seconds."""
    fit = outcome.fit
    if fit is None:
        return (outcome.status, "", "", "", "")
    return (fit.status, metres(fit.rmse), str(fit.frames), str(fit.evaluations), f"{fit.seconds:.1f}")


def summaries(
    items: Sequence[Item], results: Sequence[Result], errors: Mapping[int, ClothfitError]
) -> list[dict[str, Any]]:
    """What --json prints of each scene, in the order of the arguments."""
    found = []
    for index, (item, result) in enumerate(zip(items, results, strict=True)):
        error = errors.get(index)
        outcome = result.outcome
        written = item.out is not None and outcome.usable and error is None
        own: dict[str, Any] = {"status": outcome.status}
        if result.fit is not None and item.out is not None:
            own = outcomes.summary(result.fit.scene, result.fit, item.out)
        own |= {
            "scene": item.path,
            "output": item.out.path if written and item.out else None,
            "exit_code": error.exit_code if error else result.exit_code,
            "error": str(error or outcome.error or "") or None,
        }
        own |= motions.readings_summary(item.readings)
        if len(result.outcomes) > 1:
            own |= {"start": result.best + 1, "starts": [start_summary(one) for one in result.outcomes]}
        found.append(own)
    return found


def start_summary(outcome: Outcome) -> dict[str, Any]:
    """What --json prints of one of several starts."""
    fit = outcome.fit
    names = ("cost", "rmse", "evaluations", "seconds")
    numbers = {name: None if fit is None else getattr(fit, name) for name in names}
    return {"status": outcome.status, "exit_code": outcome.exit_code, "error": outcome.error, **numbers}
