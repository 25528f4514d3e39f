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
    assert issubclass(clothfit.InvalidScene, clothfit.InvalidInput)
    assert issubclass(clothfit.InvalidMotion, clothfit.InvalidInput)
    assert issubclass(clothfit.InvalidInput, ValueError)
    assert issubclass(clothfit.Diverged, clothfit.ClothfitError)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'clothfit' has no attribute 'fold'"):
        clothfit.fold  # noqa: B018


def used(names):
    """Code that uses names of the package."""
    return f"import clothfit; [getattr(clothfit, name) for name in {names}]"


NAMES = [*CALLS, "evaluate", "degrade"]
MODULES = "; ".join(f"import clothfit.{home}" for home in HOMES)
REVERSED = "; ".join(f"import clothfit.{home}" for home in reversed(HOMES))


@pytest.mark.parametrize(
    "before",
    [f"{used(NAMES)}; {MODULES}", REVERSED, f"import clothfit.cli.evaluate, clothfit.cli.estimate; {MODULES}"],
    ids=["names first", "modules first", "commands first"],
)
def test_names_are_functions_in_whatever_order_names_are_used_and_modules_imported(before):
    code = f"{before}; import clothfit, inspect; "
    assert python(code + f"print(*[n for n in {NAMES} if not inspect.isfunction(getattr(clothfit, n))])") == []
