"""The types of the public names, as a user's type checker sees them (`py.typed`)."""

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path
from textwrap import indent

import pytest
from helpers.modules import script
from helpers.paths import DOCS

import clothfit

pytestmark = pytest.mark.slow  # starts processes

pytest.importorskip("mypy", reason="mypy is not installed; the extras test and dev have it")

OPTIONAL = ("union-attr", "index", "operator", "no-untyped-def")
"""What examples leave out: to ask whether something is None, and the types of their own functions."""

SKIPPED = """
[mypy]
[mypy-scipy.*,numba.*,llvmlite.*,distributed.*,dask.*,matplotlib.*,PIL.*,tornado.*]
follow_imports = skip
follow_imports_for_stubs = True
"""
"""The settings: packages that no public name has types of, whose thousand files take three quarters of the time."""

CALLS = """
def lowest(motion: clothfit.Motion) -> tuple[float, np.ndarray]:
    return float(motion.positions[-1, 0, 1] ** 2), np.zeros(motion.positions.shape)

def heights(motion: clothfit.Motion) -> tuple[np.ndarray, np.ndarray]:
    return motion.positions[-1, :, 1], np.eye(motion.positions.size)[-48::3]

class Printing(clothfit.Observer):
    def result(self, scene: clothfit.Scene) -> None:
        print(scene.name)

motion = clothfit.simulate(scene, frames=20, tolerance=1e-10)
fit = clothfit.estimate(scene, [motion, (motion, scene)], time_limit="30s", observer=Printing())
own = clothfit.estimate(scene, options=clothfit.FitOptions(objective=lowest, max_evaluations=5))
own_options = clothfit.FitOptions(objective=clothfit.Residuals(heights), fit="wind", bounds={"mass": (1e-6, None)})
own = clothfit.estimate(scene, "target.pc2", method="gauss-newton", options=own_options)
evaluation = clothfit.evaluate(scene, fit.scene, target=Path("target.npz"))
print(evaluation.fitted.rmse, [block.interval[0] for block in fit.parameters])
"""


def right():
    """The examples of the reference, each a function, and calls with options of all types."""
    reference = script(DOCS / "python.py")
    parsed = doctest.DocTestParser().get_examples
    code = {name: "".join(each.source for each in parsed(text)) for name, text in reference.examples().items()}
    start = "from pathlib import Path\nimport numpy as np\n" + code.pop(reference.START)
    own = [f"def example_{i}() -> None:\n{indent(each, '    ')}" for i, each in enumerate(code.values())]
    return "\n".join([start, *own, CALLS])


def checked(folder, script):
    """What `mypy --strict` says of a script in a folder of its own, where only the installed package is to be seen."""
    (folder / "script.py").write_text(script, "utf-8")
    (folder / "mypy.ini").write_text(SKIPPED, "utf-8")
    installed = str(Path(clothfit.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([installed, os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", "mypy", "--strict", f"--cache-dir={os.devnull}", "script.py"]
    command += [f"--disable-error-code={code}" for code in OPTIONAL]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.stdout


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    """What it says of a right script, then of every name, and of calls that are wrong."""
    names = "".join(f"reveal_type(clothfit.{name})\n" for name in clothfit.__all__)
    wrong = (
        'clothfit.simulate("scene.json")\n'
        'clothfit.estimat(scene)\n'
        'fit.rmse.upper()\n'
        'motion.positions = motion.times\n'
        'clothfit.estimate(scene, presicion=1.0)\n'
        'clothfit.estimate(scene, options=clothfit.FitOptions(objective=lambda motion: 1.0))\n'
    )
    return checked(tmp_path_factory.mktemp("types"), f"{right()}\n{names}\n{wrong}")


def lines(output, kind):
    """The numbers of the lines of which it says something of a kind."""
    return [int(line) for line in re.findall(rf"^script\.py:(\d+): {kind}:", output, re.MULTILINE)]


def test_a_strict_type_checker_finds_nothing_wrong_with_calls_that_are_right(output):
    assert [line for line in lines(output, "error") if line <= right().count("\n")] == [], output


def test_it_knows_the_type_of_every_public_name(output):
    types = re.findall(r'Revealed type is "(.*)"', output)
    assert len(types) == len(clothfit.__all__)
    assert [kind for kind in types if kind == "Any"] == []


def test_it_finds_calls_that_are_wrong(output):
    last = right().count("\n") + len(clothfit.__all__) + 2
    assert sorted(set(lines(output, "error"))) == [last + k for k in (1, 2, 3, 4, 5, 6)], output
