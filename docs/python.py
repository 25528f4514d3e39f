"""Write `build/docs/python.md`, the reference of all public names, from their signatures, docstrings and comments.

`make docs` runs this. The examples stand in `python_examples.txt`, and a test runs them: a line `[name]`, then what one
types and sees. Fields of classes are described by the comments behind them.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import clothfit

PAGE = Path(__file__).parents[1] / "build" / "docs" / "python.md"
EXAMPLES = Path(__file__).with_name("python_examples.txt")
WIDTH = 96  # columns of a signature
START = "start"  # the example that all others begin with

HEAD = """
# Python

Written by `make docs` from the docstrings of the package.

`import clothfit` loads a module when one of its names is first used, so it takes no time by itself. All quantities are
in SI units and all arrays are float64 unless something else is said. The package has type hints (`py.typed`).

| in signatures | is |
|---|---|
| `Array`, `Flags`, `Indices` | NumPy arrays of float64, bool and int32 |
| `Recorded` | a `Motion`, an array (frames, vertices, 3), or the path of a motion file |
| `Targets` | one of these; a pair of one and the `Scene` of its recording; a list |
| `Compared` | what is compared: an objective by its name, several with their weights, or a cost of one's own |
| `Readable` | a path, an open file, or a dict with the fields of the file |
| P, n, S, T | the number of fitted values, and of a cloth's vertices, springs and triangles |

Every example begins with these lines, and a test runs them all:
"""

GROUPS: dict[str, tuple[str, ...]] = {
    "Scenes": ("load", "save", "Scene", "Cloth", "parameters", "with_parameters"),
    "Scenes from meshes": ("new_scene", "read_mesh", "mesh", "mesh_problems", "weld"),
    "Motions": (
        "simulate", "Motion", "as_motion", "load_motion", "save_motion", "Reading", "Convention", "degrade",
        "energies", "Energy",
    ),
    "Fits": ("estimate", "FitOptions", "Observer", "Fit", "estimate_many", "evaluate", "Evaluation", "report_page"),
    "Keyframes": (
        "find_forces", "find_controls", "Controls", "Handle", "Control", "Costs", "Key", "load_keys", "Forces",
        "load_forces", "save_forces",
    ),
    "Costs and gradients": ("cost_and_gradient", "Objective", "Residuals", "check_scene", "SceneCheck", "verify"),
    "Live": ("Engine", "connect"),
    "Speed and accuracy": ("work_precision", "WorkPrecision"),
    "Errors": ("ClothfitError", "InvalidInput", "InvalidScene", "InvalidMotion", "Diverged"),
}  # fmt: skip

MODULES = {
    "mesh": ("plane", "Mesh", "areas", "springs", "Springs", "masses", "air_drag", "object_document"),
    "mesh_problems": ("problems", "Problem", "tiny"),
    "verify": ("check", "Report", "taylor_order", "central_difference_error", "dot_product_error"),
    "weld": ("weld", "Welded"),
}
"""Of the public modules, what is for users."""

PARTS = {
    "Scene": ("scene.scene.Sphere",),
    "Control": ("control.control.Reached",),
    "Forces": ("scene.forces.Regulator",),
    "FitOptions": tuple(f"fit.options.{name}Options" for name in ("Comparison", "Capture", "Model", "Search")),
    "Observer": ("optimise.progress.Progress", "fit.hints.Hint", "objective.memory_needs.Needs"),
    "Fit": ("fit.result.FittedBlock", "fit.result.Verdict", "fit.result.Scatter", "fit.holdout.HeldOut"),
    "estimate_many": ("many.estimate_many.Result", "many.job.Outcome"),
    "Evaluation": ("evaluation.evaluate.Distance", "evaluation.evaluate.Deviation"),
    "SceneCheck": ("evaluation.gradient_check.Finding",),
    "WorkPrecision": ("evaluation.work_precision.Row",),
}
"""Classes that one meets in the fields and results of others."""


class Field(NamedTuple):
    """A field of a class."""

    name: str
    type: str
    default: str
    meaning: str  # the comment behind it


def examples() -> dict[str, str]:
    """The example of each name, as typed and seen."""
    parts = re.split(r"^\[([\w.]+)\]\n", EXAMPLES.read_text("utf-8"), flags=re.MULTILINE)[1:]
    return {name: text.strip("\n") for name, text in zip(parts[::2], parts[1::2], strict=True)}


@cache
def tree(module: ModuleType) -> dict[str, ast.stmt]:
    """The classes and functions of a module, by their names."""
    body = ast.parse(inspect.getsource(module)).body
    return {node.name: node for node in body if isinstance(node, (ast.ClassDef, ast.FunctionDef))}


def node_of(value: Any) -> ast.stmt:
    """The source of a class or function."""
    module = inspect.getmodule(value)
    assert module is not None
    return tree(module)[value.__name__]


def written(node: ast.expr | None, module: ModuleType) -> str:
    """A default as its reader would write it: a constant of the module by its value."""
    if node is None:
        return ""
    value = getattr(module, node.id, None) if isinstance(node, ast.Name) else None
    return repr(value) if isinstance(value, (bool, int, float, str)) else ast.unparse(node)


def signature(name: str, node: ast.FunctionDef, module: ModuleType) -> str:
    """A call with its arguments, types and defaults; on one line where it fits."""
    asked = node.args
    listed: list[str] = []
    defaults: list[ast.expr | None] = [None] * (len(asked.args) - len(asked.defaults)) + list(asked.defaults)
    for one, default in zip(asked.args, defaults, strict=True):
        if one.arg != "self":
            listed.append(argument(one, default, module))
    if asked.vararg or asked.kwonlyargs:
        listed.append(f"*{asked.vararg.arg}" if asked.vararg else "*")
    listed += [argument(one, default, module) for one, default in zip(asked.kwonlyargs, asked.kw_defaults, strict=True)]
    if asked.kwarg:
        listed.append(argument(asked.kwarg, None, module, "**"))
    result = "" if node.returns is None or node.name == "__init__" else f" -> {ast.unparse(node.returns)}"
    line = f"{name}({', '.join(listed)}){result}"
    if len(line) <= WIDTH:
        return line
    return "\n".join([f"{name}(", *(f"    {one}," for one in listed), f"){result}"])


def argument(one: ast.arg, default: ast.expr | None, module: ModuleType, stars: str = "") -> str:
    """An argument with its type and default."""
    kind = f": {ast.unparse(one.annotation)}" if one.annotation else ""
    value = written(default, module)
    return f"{stars}{one.arg}{kind}" + (f" = {value}" if value and kind else f"={value}" if value else "")


def fields(value: type) -> list[Field]:
    """The fields of a class, those of its bases first, each with the comment behind or above it."""
    found = {}
    for base in reversed(value.__mro__):
        if base.__module__.startswith("clothfit."):
            found.update({field.name: field for field in own_fields(base)})
    return list(found.values())


def own_fields(value: type) -> Iterator[Field]:
    """The fields that a class adds to its bases."""
    module = inspect.getmodule(value)
    assert module is not None
    lines = inspect.getsource(module).splitlines()
    node = node_of(value)
    assert isinstance(node, ast.ClassDef)
    for one in node.body:
        if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name):
            comment = lines[(one.end_lineno or one.lineno) - 1][one.end_col_offset :].strip().removeprefix("#").strip()
            yield Field(one.target.id, ast.unparse(one.annotation), written(one.value, module), comment)


def methods(value: type) -> Iterator[tuple[str, str]]:
    """The public methods and properties of a class: how they are used, and what they say of themselves."""
    node, module = node_of(value), inspect.getmodule(value)
    assert isinstance(node, ast.ClassDef)
    assert module is not None
    for one in node.body:
        if isinstance(one, ast.FunctionDef) and not one.name.startswith("_"):
            plain = any("property" in ast.unparse(decorator) for decorator in one.decorator_list)
            kind = f": {ast.unparse(one.returns)}" if one.returns else ""
            used = f"{one.name}{kind}" if plain else signature(one.name, one, module)
            yield re.sub(r",? \)", ")", " ".join(used.split()).replace("( ", "(")), ast.get_docstring(one) or ""


def prose(text: str | None) -> str:
    """A docstring as Markdown: formulas stay as they are."""
    blocks = re.split(r"\n\n+", inspect.cleandoc(text or ""))
    return "\n\n".join(block if block.startswith("    ") else " ".join(block.split()) for block in blocks)


def cell(text: str) -> str:
    """A text as the cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


def table(head: str, rows: list[tuple[str, ...]]) -> str:
    """A table of a head and rows."""
    width = head.count("|") - 1
    return "\n".join([head, "|" + "---|" * width, *("| " + " | ".join(map(cell, row)) + " |" for row in rows)])


def class_parts(value: type) -> Iterator[str]:
    """The paragraphs on a class: what it is, its fields, its methods."""
    yield prose(value.__doc__)
    if (rows := fields(value)) and value is not clothfit.FitOptions:  # its parts have them
        optional = any(row.default for row in rows)
        listed = [(f"`{row.name}`", f"`{row.type}`", row.meaning) for row in rows]
        if optional:
            defaults = [f"`{row.default}`" if row.default else "" for row in rows]
            listed = [(*row[:2], default, row[2]) for row, default in zip(listed, defaults, strict=True)]
        yield table("| field | type | default | |" if optional else "| field | type | |", listed)
    if used := list(methods(value)):
        yield table("| method or property | |", [(f"`{name}`", text) for name, text in used])


def entry(title: str, value: Any, level: str, shown: dict[str, str], name: str) -> Iterator[str]:
    """The paragraphs on a public class or function; `title` is how it is written after `import clothfit`."""
    yield f"{level} {title}"
    node, module = node_of(value), inspect.getmodule(value)
    assert module is not None
    if isinstance(node, ast.FunctionDef):
        yield f"```python\n{signature(title, node, module)}\n```"
        yield prose(value.__doc__)
    else:
        assert isinstance(node, ast.ClassDef)
        begun = [one for one in node.body if isinstance(one, ast.FunctionDef) and one.name == "__init__"]
        for one in begun:
            yield f"```python\n{signature(title, one, module)}\n```"
        yield from class_parts(value)
        for one in begun:
            if text := ast.get_docstring(one):
                yield prose(text)
    if name in shown:
        yield f"```pycon\n{shown[name]}\n```"


def part(path: str) -> Iterator[str]:
    """The paragraphs on a class that one meets, but does not make."""
    home, _, name = path.rpartition(".")
    yield f"#### {name}"
    yield from class_parts(getattr(__import__(f"clothfit.{home}", fromlist=[name]), name))


def chapter(name: str, shown: dict[str, str]) -> Iterator[str]:
    """The paragraphs on a public name, be it a module."""
    value = getattr(clothfit, name)
    if not isinstance(value, ModuleType):
        yield from entry(f"clothfit.{name}", value, "###", shown, name)
        for path in PARTS.get(name, ()):
            yield from part(path)
        return
    yield f"### The module clothfit.{name}"
    yield prose(value.__doc__)
    for each in MODULES[name]:
        yield from entry(f"clothfit.{name}.{each}", getattr(value, each), "####", shown, f"{name}.{each}")


def page() -> str:
    """The page."""
    shown = examples()
    begin = "\n".join(line[4:] for line in shown[START].splitlines())
    found = [inspect.cleandoc(HEAD), f"```python\n{begin}\n```"]
    for title, names in GROUPS.items():
        found += [f"## {title}", *(text for name in names for text in chapter(name, shown))]
    return "\n\n".join(text for text in found if text) + "\n"


if __name__ == "__main__":
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
