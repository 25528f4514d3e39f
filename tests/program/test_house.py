"""The rules of docs/architecture.md, read from the syntax trees: what may import what."""

import ast
import io
import tokenize
from graphlib import TopologicalSorter

import pytest
from helpers.paths import ROOT

from clothfit.cli.program import COMMANDS

PACKAGE = ROOT / "clothfit"

FOLDERS = [
    "base", "kernels", "scene", "formats", "fabric", "meshes", "engine", "motion", "derivative", "objective",
    "registration", "optimise", "fit", "control", "evaluation", "many", "subspace", "pictures", "report",
    "export", "simulators", "live", "cli",
]  # fmt: skip
"""From the bottom to the top: the path of the data."""

ENGINE = ["solve", "forces", "inputs", "system", "step", "march", "rollout", "tape"]
"""The floors of the engine, from the bottom to the top; what is not here imports as it likes within the engine."""

CODE_LINES, FILES, FLOORS = 50_041, 367, 13
"""The weight of the package: lines with code, modules, and folders in the longest chain of imports. They may fall; who
raises one says in the commit why.
"""


def name_of(path):
    """Dotted name of a module below the package; "" is the package itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree, known):
    """Modules of the package that a module imports, anywhere in it, also for types only."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.split(".")[0] == "clothfit"}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0  # no import is relative
            if (node.module or "").split(".")[0] != "clothfit":
                continue
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name.partition(".")[2] in known else node.module for name in full}
    return {name.partition(".")[2] for name in found}


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}
FACE = {"", "__main__"}
"""The public names, which load everything: they stand above all folders but the command line, which uses them."""


@pytest.fixture(scope="module")
def sources():
    """The text of each module."""
    return {name: path.read_text("utf-8") for name, path in MODULES.items()}


@pytest.fixture(scope="module")
def trees(sources):
    """The syntax tree of each module."""
    return {name: ast.parse(source) for name, source in sources.items()}


@pytest.fixture(scope="module")
def imported(trees):
    """What each module imports of the package."""
    return {name: imports(tree, MODULES) for name, tree in trees.items()}


def height(name, order):
    """The place of a module's first part in an order; None where it has none."""
    first = name.split(".")[0]
    return order.index(first) if first in order else None


def upward(name, used, order=FOLDERS):
    """What of a module's imports stands above it in an order of folders."""
    own = height(name, order)
    heights = {module: height(module, order) for module in used}
    return sorted(module for module, other in heights.items() if None not in (own, other) and other > own)


def test_a_module_imports_only_folders_that_stand_before_its_own(imported):
    found = {name: upward(name, used) for name, used in imported.items() if name not in FACE}
    assert {name: used for name, used in found.items() if used} == {}


@pytest.mark.parametrize("folder", FOLDERS)
def test_there_is_no_circle_within_a_folder(folder, imported):
    inside = {name for name in MODULES if name == folder or name.startswith(f"{folder}.")}
    graph = {name: (imported[name] & inside) - {name} for name in inside}
    assert len(list(TopologicalSorter(graph).static_order())) == len(inside)  # CycleError names the circle


def test_every_file_stands_in_a_folder_of_the_list_and_only_the_command_line_uses_the_public_names(imported):
    assert {name.split(".")[0] for name in MODULES} - FACE == set(FOLDERS)
    assert {name for name, path in MODULES.items() if path.parent == PACKAGE} == FACE
    assert {name.split(".")[0] for name, used in imported.items() if used & FACE} <= {"cli", "__main__"}


def test_the_engine_has_floors(imported):
    for name in MODULES:
        if name.startswith("engine."):
            inside = {module.removeprefix("engine.") for module in imported[name] if module.startswith("engine.")}
            assert upward(name.removeprefix("engine."), inside, ENGINE) == [], name


def test_the_page_of_a_folder_says_what_is_there_and_imports_nothing(trees):
    for name in [name for name, path in MODULES.items() if path.name == "__init__.py"][1:]:
        assert [type(node) for node in trees[name].body] == [ast.Expr], name
        assert len((ast.get_docstring(trees[name]) or "").split("\n")) >= 4, name


def test_the_files_of_the_command_line_are_the_commands():
    files = [path.stem for path in (PACKAGE / "cli").glob("*.py") if path.stem not in ("__init__", "program")]
    assert sorted(files) == sorted(COMMANDS)


SILENT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip
DOCUMENTED = (ast.Module, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def code_lines(source, tree):
    """How many lines have code: no comments, no docstrings, no blank ones."""
    words = [word for word in tokenize.generate_tokens(io.StringIO(source).readline) if word.type not in SILENT]
    lines = {line for word in words for line in range(word.start[0], word.end[0] + 1)}
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            lines -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(lines)


def longest_chain(imported):
    """The folders of the longest chain of imports between the folders of the list."""
    graph = {folder: set() for folder in FOLDERS}
    for name in set(MODULES) - FACE:
        graph[name.split(".")[0]] |= {used.split(".")[0] for used in imported[name] - FACE}
    length = dict.fromkeys(FOLDERS, 1)
    for folder in FOLDERS:  # no import leads up
        length[folder] += max((length[below] for below in graph[folder] - {folder}), default=0)
    return max(length.values())


def test_the_package_does_not_grow_without_a_reason(sources, trees, imported):
    page = '"""A page."""\n\nX = (1,  # one\n     2)\n\ndef f():\n    """Words."""\n    return X\n'
    assert code_lines(page, ast.parse(page)) == 4
    assert sum(code_lines(sources[name], trees[name]) for name in MODULES) <= CODE_LINES
    assert len(MODULES) <= FILES
    assert longest_chain(imported) <= FLOORS
