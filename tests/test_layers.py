"""Imports go strictly downwards: the order of the modules, read from the syntax trees."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "clothfit"

# From the bottom to the top: a module imports only modules that stand before it. A package without lines for its
# modules is one entry; what it holds may import each other.
ORDER = [
    "errors",
    "arrays",
    "kinds",
    "verify",
    "words",
    "interrupts",
    "memory",
    "limits",
    "kernel_cache",
    "kernel",
    "lanes",
    "vectors",
    "guess",
    "team",
    "temporary",
    "output",
    "steady",
    "reading",
    "npz",
    "axes",
    "animation",
    "convention",
    "formats",
    "source",
    "splice",
    "conforms",
    "structure",
    "checks",
    "scene",
    "mesh",
    "mesh_file",
    "topology",
    "mesh_problems",
    "weld",
    "mesh_numbering",
    "fixing",
    "scene_text",
    "scene_making",
    "overview",
    "sparse",
    "ssor",
    "multigrid",
    "cg",
    "linear",
    "forces",
    "forces.vertex",
    "forces.springs",
    "forces.wind",
    "forces.spheres",
    "system",
    "stencil",
    "forces.total",
    "step",
    "step.guard",
    "step.explicit",
    "step.implicit",
    "step.transition",
    "step.jacobian",
    "rollout",
    "remedies",
    "stability_limit",
    "divergence",
    "tape",
    "adjoint",
    "sensitivity",
    "motion",
    "native",
    "likeness",
    "markers",
    "foreign",
    "motion_files",
    "energy",
    "runge_kutta",
    "richardson",
    "setting",
    "trial",
    "precision",
    "experiment",
    "target",
    "capture",
    "loss",
    "objectives",
    "objectives.position",
    "objectives.velocity",
    "objectives.edge_length",
    "objectives.spectrum",
    "cost",
    "tally",
    "passing",
    "normal",
    "block",
    "fit_vector",
    "run",
    "storage",
    "forecast",
    "columns",
    "objective",
    "switching",
    "ladder",
    "scene_check",
    "holdout",
    "coordinates",
    "checkpoint",
    "journal",
    "search",
    "threads",
    "bounded",
    "prior",
    "null_space",
    "material",
    "start",
    "balances",
    "momentum",
    "gauss_newton",
    "resumable",
    "trajectory",
    "shares",
    "confidence",
    "scan",
    "matrix_free",
    "descent",
    "auto",
    "result",
    "fit",
    "evaluation",
    "fit_methods",
    "picture",
    "diagram",
    "view",
    "stage",
    "overlay",
    "film",
    "gif",
    "maps",
    "charts",
    "plots",
    "",
    "report",
    "starts",
    "job",
    "worker",
    "batch",
    "compiled",
    "warmup",
    "pool",
    "cluster",
    "many",
    "export",
    "cli",
    "__main__",
]


def name_of(path):
    """Dotted name of a module below the package; "" is the package itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def entry(name):
    """The line of ORDER for a module: its own, or that of the package it is in."""
    while name not in ORDER and "." in name:
        name = name.rpartition(".")[0]
    return name


def for_types_only(node):
    """Whether a node is an `if TYPE_CHECKING:`, which never runs."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def nodes(tree):
    """All nodes that can run."""
    for child in ast.iter_child_nodes(tree):
        if not for_types_only(child):
            yield child
            yield from nodes(child)


def imports(source):
    """Modules of the package that a source imports, anywhere in it."""
    found = set()
    for node in nodes(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.split(".")[0] == "clothfit"}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "clothfit":
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name.partition(".")[2] in MODULES else node.module for name in full}
    return {name.partition(".")[2] for name in found}


def test_every_module_has_its_place():
    assert [name for name in MODULES if entry(name) not in ORDER] == []
    assert len(set(ORDER)) == len(ORDER)
    assert [name for name in ORDER if name not in MODULES] == []


def upward(name, source):
    """What the source of a module imports that does not stand before it."""
    own = entry(name)
    used = imports(source) - {name}
    # the modules of a package without lines of their own, and a package's own name in its __init__, are at one height
    beside = {module for module in used if entry(module) == own and (own != name or module.startswith(f"{own}."))}
    return sorted(module for module in used - beside if ORDER.index(entry(module)) >= ORDER.index(own))


@pytest.mark.parametrize("name", sorted(MODULES))
def test_a_module_imports_only_what_stands_before_it(name):
    assert upward(name, MODULES[name].read_text("utf-8")) == []


@pytest.mark.parametrize(
    ("name", "source", "found"),
    [
        ("scene", "from clothfit import motion", ["motion"]),
        ("forces.wind", "def later():\n    from clothfit.engine.forces import total", ["forces.total"]),
        ("errors", "import clothfit.objective.objective", ["objective"]),
        ("cost", "from clothfit.scene.scene import Scene", []),
    ],
)
def test_an_import_from_above_is_found(name, source, found):
    assert upward(name, source) == found


def test_there_are_no_relative_imports():
    trees = {name: ast.parse(path.read_text("utf-8")) for name, path in MODULES.items()}
    assert [name for name, tree in trees.items() for node in nodes(tree) if getattr(node, "level", 0)] == []


def test_the_reading_of_imports():
    source = """
import clothfit.cost
from clothfit import adjoint, __version__
from clothfit.forces import total
from clothfit.step.implicit import step
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from clothfit import fit
def later():
    from clothfit.scene import load
"""
    assert imports(source) == {"cost", "adjoint", "", "forces.total", "step.implicit", "scene"}


def test_the_derivative_checks_stand_at_the_bottom():
    assert imports(MODULES["verify"].read_text("utf-8")) <= {"errors", "arrays"}
