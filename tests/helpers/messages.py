"""The error messages of the program, read from its syntax trees, and the table of them in `docs/errors.md`.

A message is a template: what the program puts in is `…`. A sentence is found wherever it is given to something that
raises, reports or collects errors (`CALLS`), or is what a function named for that gives (`GIVERS`). Whatever else is
raised must be one of the exceptions that tell nobody anything (`SILENT`).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from helpers.paths import ROOT

PACKAGE, TABLE = ROOT / "clothfit", ROOT / "docs" / "errors.md"
GAP = "…"

CALLS = {
    **dict.fromkeys(("InvalidInput", "InvalidScene", "InvalidMotion", "Diverged", "Failed"), 0),
    **dict.fromkeys(("ClothfitError", "UsageError", "Died", "Lost", "_fail", "append"), 0),
    **dict.fromkeys(("ValueError", "TypeError", "EOFError", "BadZipFile"), 0),  # become the reason of another message
    **dict.fromkeys(("_refusal", "refuse", "OSError", "PermissionError"), 1),
    **dict.fromkeys(("Outcome", "require", "_report"), 2),
    **dict.fromkeys(("_report_springs", "check"), 3),
    "Finding": 4,
}
"""Which argument of a call is a sentence; that of `append` where it is to a list of problems."""

GIVERS = re.compile(r".*_problems?|_sentence|_obstacle|_repetition|_not_finite|_gone|left_out|difference_of")
"""Functions that return or yield sentences, or parts of them."""

SILENT = ("KeyboardInterrupt", "BrokenPipeError", "AttributeError", "Stop", "MissingParameter", "outcome")
"""Exceptions whose words are nobody's message: requests to end, Python's own questions, statuses of a fit, and what the
library that reads the command line puts into words of its own; and a function that makes one, looked at itself."""

WITHIN = {
    "no record": "checkpoint.decoded has another sentence for it",
    "no content": "checkpoint.decoded has another sentence for it",
    "there is no status …": "Journal.trusted has another sentence for it",
    "belongs to another user": "a part of a warning",
    "the value at … has no end": "no text that was parsed comes there",
    "there is no result": "an outcome without a fit has its error",
    "steps above … of the values are left out: …": "below the table of `check`",
    "no two steps are short enough": "in the table of `check`",
    "nothing that is checked changes the cost": "in the table of `check`",
    "known to … only": "in the table of `check`",
}
"""Sentences that never reach the user as an error, and why."""


ELSEWHERE = ("export/blender_script.py",)
"""What is in the package, but runs in another program, whose user it speaks to."""


class Row(NamedTuple):
    """One row of the table."""

    message: str
    codes: str  # exit codes; where there are several, the reason decides
    meaning: str


def modules() -> list[Path]:
    """The files of the program."""
    return sorted(set(PACKAGE.rglob("*.py")) - {PACKAGE / name for name in ELSEWHERE})


def templates() -> dict[str, list[str]]:
    """The places, file and line, of each template."""
    found: dict[str, list[str]] = {}
    for path in modules():
        tree = ast.parse(path.read_text("utf-8"))
        for node, scope in nodes(tree, tree):
            for sentence in sentences(node, scope, tree):
                place = f"{path.relative_to(PACKAGE)}:{node.lineno}"
                found.setdefault(normal(sentence), []).append(place)
    told = {text: places for text, places in found.items() if re.search(r"[a-z]{2}", text)}
    return {text: places for text, places in told.items() if text not in WITHIN}


def raised() -> dict[str, list[str]]:
    """The places, file and line, where each exception is raised that is made there, by its name."""
    found: dict[str, list[str]] = {}
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                name = getattr(node.exc.func, "attr", getattr(node.exc.func, "id", ""))
                found.setdefault(name, []).append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    return found


def nodes(node: ast.AST, scope: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Every node, with the function it stands in."""
    for child in ast.iter_child_nodes(node):
        yield child, scope
        yield from nodes(child, child if isinstance(child, ast.FunctionDef) else scope)


def sentences(node: ast.AST, scope: ast.AST, tree: ast.Module) -> Iterator[str]:
    """The sentences that a node gives to the user."""
    if isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if name == "append" and getattr(getattr(node.func, "value", None), "id", "") != "problems":
            return
        position = CALLS.get(name)
        if position is not None and len(node.args) > position:
            yield from texts(node.args[position], scope, tree)
    elif isinstance(node, (ast.Return, ast.Yield)) and GIVERS.fullmatch(getattr(scope, "name", "")):
        yield from texts(node.value or ast.Constant(None), scope, tree)


def texts(node: ast.AST, scope: ast.AST, tree: ast.Module) -> Iterator[str]:
    """What an expression may be, as templates; nothing for what another place has made."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield "".join(part.value if isinstance(part, ast.Constant) else GAP for part in node.values)
    elif isinstance(node, ast.IfExp):
        yield from texts(node.body, scope, tree)
        yield from texts(node.orelse, scope, tree)
    elif isinstance(node, ast.BoolOp):
        for item in node.values:
            yield from texts(item, scope, tree)
    elif isinstance(node, ast.Lambda):
        yield from texts(node.body, scope, tree)
    elif isinstance(node, (ast.Tuple, ast.List)):
        for item in node.elts:
            yield from texts(item, scope, tree)
    elif isinstance(node, ast.ListComp):
        yield from texts(node.elt, scope, tree)
    elif isinstance(node, ast.Name):
        for place in (scope, tree):
            for other in ast.walk(place) if place is scope else tree.body:
                if isinstance(other, ast.Assign) and node.id in [getattr(t, "id", "") for t in other.targets]:
                    yield from texts(other.value, scope, tree)


def normal(text: str) -> str:
    """A template without the place before it; values are gaps, gaps in a row one."""
    text = re.sub(r"\{\d*\}", GAP, text.replace("{{", "{").replace("}}", "}"))
    text = re.sub(rf"{GAP}(?:\s*{GAP})+", GAP, text)
    return re.sub(rf"^(?:{GAP}\.)?{GAP}: ", "", text).strip()


def rows() -> list[Row]:
    """The rows of the table."""
    found = re.findall(r"^\| `(.+?)` \| ([\d, ]+) \| (.+) \|$", TABLE.read_text("utf-8"), re.MULTILINE)
    return [Row(*row) for row in found]


def pattern(message: str) -> re.Pattern[str]:
    """What matches a message with anything in its gaps."""
    return re.compile(".*".join(map(re.escape, message.split(GAP))), re.DOTALL)
