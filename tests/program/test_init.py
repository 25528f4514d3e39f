"""The public names: there, lazy, and functions in whatever order modules are imported."""

import inspect
import subprocess
import sys

import pytest
from helpers.scenes import environment

import clothfit

pytestmark = pytest.mark.slow  # starts processes

CALLS = {
    "load": ["path_or_file"],
    "save": ["scene", "path_or_file"],
    "simulate": ["scene", "frames", "tolerance"],
    "parameters": ["scene"],
    "with_parameters": ["scene", "p"],
    "cost_and_gradient": ["scene", "motion", "tolerance"],
    "estimate": ["scene", "target", "start", "method"],
}
HOMES = [
    "motion.degrade", "evaluation.evaluate", "fit.estimate", "scene.fit_vector", "motion.motion", "objective.objective",
    "scene.scene", "base.errors",
]


def python(code):
    """What a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment(), check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_importing_loads_no_numerical_library_and_loading_a_scene_needs_no_simulation():
    heavy = ("numba", "scipy", "numpy", "rich", "click", "jsonschema")
    code = f"import sys, clothfit; dir(clothfit); print(*[name for name in {heavy} if name in sys.modules])"
    more = "clothfit.load; print(*[name for name in ('numba', 'scipy') if name in sys.modules])"
    assert python(f"{code}; {more}") == []


@pytest.mark.parametrize("name", CALLS)
def test_the_documented_arguments_come_first(name):
    given = list(inspect.signature(getattr(clothfit, name)).parameters)
    assert given[: len(CALLS[name])] == CALLS[name]


def test_all_names_exist_and_are_listed():
    names = {*CALLS, "evaluate", "Scene", "Motion", "Fit", "InvalidScene", "Diverged"}
    assert names <= set(clothfit.__all__) <= set(dir(clothfit))
    assert sorted(clothfit.__all__) == clothfit.__all__
    assert clothfit.__version__.count(".") == 2
    code = "import clothfit; print(*[name for name in clothfit.__all__ if not callable(getattr(clothfit, name))]); "
    code += "from clothfit import *; print(verify.__name__, mesh.plane.__name__)"
    assert python(code) == [*sorted(clothfit._MODULES), "clothfit.derivative.verify", "plane"]


def test_errors_are_what_they_should_be():
    of = {"InvalidScene": "InvalidInput", "InvalidMotion": "InvalidInput", "Diverged": "ClothfitError"}
    assert all(issubclass(getattr(clothfit, name), getattr(clothfit, base)) for name, base in of.items())
    assert issubclass(clothfit.InvalidInput, ValueError)
    with pytest.raises(AttributeError, match="module 'clothfit' has no attribute 'fold'"):
        clothfit.fold  # noqa: B018


NAMES = [*CALLS, "evaluate", "degrade"]
USED = f"import clothfit; [getattr(clothfit, name) for name in {NAMES}]"


@pytest.mark.parametrize("first", [USED, "", "import clothfit.cli.evaluate, clothfit.cli.estimate"],
                         ids=["names first", "modules first", "commands first"])  # fmt: skip
def test_names_are_functions_in_whatever_order_names_are_used_and_modules_imported(first):
    modules = "; ".join(f"import clothfit.{home}" for home in (HOMES if first else reversed(HOMES)))
    code = f"print(*[n for n in {NAMES} if not inspect.isfunction(getattr(clothfit, n))])"
    assert python(f"{first}\n{modules}; import clothfit, inspect; {code}") == []
