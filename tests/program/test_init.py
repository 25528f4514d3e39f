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


def test_importing_loads_no_numerical_library():
    heavy = ("numba", "scipy", "numpy", "rich", "click", "jsonschema")
    code = f"import sys, clothfit; dir(clothfit); print(*[name for name in {heavy} if name in sys.modules])"
    assert python(code) == []


def test_loading_a_scene_needs_no_simulation():
    code = "import sys, clothfit; clothfit.load; print(*[name for name in ('numba', 'scipy') if name in sys.modules])"
    assert python(code) == []


@pytest.mark.parametrize("name", CALLS)
def test_the_documented_arguments_come_first(name):
    given = list(inspect.signature(getattr(clothfit, name)).parameters)
    assert given[: len(CALLS[name])] == CALLS[name]


def test_all_names_exist_and_are_listed():
    names = {*CALLS, "evaluate", "Scene", "Motion", "Fit", "InvalidScene", "Diverged"}
    assert names <= set(clothfit.__all__) <= set(dir(clothfit))
    assert sorted(clothfit.__all__) == clothfit.__all__
    assert clothfit.__version__.count(".") == 2
    code = "import clothfit; print(*[name for name in clothfit.__all__ if not callable(getattr(clothfit, name))])"
    assert python(code) == sorted(clothfit._MODULES)
    assert python("from clothfit import *; print(verify.__name__, mesh.plane.__name__)") == [
        "clothfit.derivative.verify", "plane",
    ]  # fmt: skip


def test_errors_are_what_they_should_be():
    assert issubclass(clothfit.InvalidScene, clothfit.InvalidInput)
    assert issubclass(clothfit.InvalidMotion, clothfit.InvalidInput)
    assert issubclass(clothfit.InvalidInput, ValueError)
    assert issubclass(clothfit.Diverged, clothfit.ClothfitError)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'clothfit' has no attribute 'fold'"):
        clothfit.fold  # noqa: B018


@pytest.mark.parametrize("order", [HOMES, HOMES[::-1]])
def test_names_stay_functions_when_they_are_used_before_the_modules(order):
    modules = "; ".join(f"import clothfit.{home}" for home in order)
    names = [*CALLS, "evaluate", "degrade"]
    code = f"import clothfit; [getattr(clothfit, n) for n in {names}]; {modules}; import inspect; "
    code += f"print(*[n for n in {names} if not inspect.isfunction(getattr(clothfit, n))])"
    assert python(code) == []


def not_functions(modules, names):
    """Which names are not functions after the modules were imported."""
    first = "; ".join(f"import clothfit.{module}" for module in modules)
    code = f"{first}; import clothfit, inspect; "
    return python(code + f"print(*[n for n in {names} if not inspect.isfunction(getattr(clothfit, n))])")


@pytest.mark.parametrize("order", [HOMES, HOMES[::-1], ["cli", *HOMES], ["cli.evaluate", "cli.estimate"]])
def test_names_are_functions_after_the_modules_were_imported(order):
    assert not_functions(order, [*CALLS, "evaluate"]) == []


def test_degrade_is_a_function_after_its_module_was_imported():
    assert not_functions(["motion.degrade"], ["degrade"]) == []
