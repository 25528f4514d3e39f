"""The types of the public names, as a user's type checker sees them (`py.typed`)."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import clothfit

pytestmark = pytest.mark.slow  # starts processes

pytest.importorskip("mypy", reason="mypy is not installed; the extras test and dev have it")

SCRIPT = """
from pathlib import Path

import numpy as np

import clothfit

scene = clothfit.load("scene.json")
sheet = clothfit.mesh.plane(2, 1.0, upright=True)
made = clothfit.new_scene(sheet, sheet.positions[:, 1] > 0.49, wind=(0.0, 0.0, 2.0), fit="nL")
motion = clothfit.simulate(made, frames=20, tolerance=1e-10)
if motion.observed is not None:
    print(motion.observed.mean())
print(motion.positions.shape, motion.times[-1], motion.name)

p = clothfit.parameters(made)
guess = clothfit.with_parameters(made, 1.2 * p)
cost, gradient = clothfit.cost_and_gradient(guess, motion, objective={"position": 1.0}, loss="huber")
print(f"{cost:.3g}", float(np.abs(gradient).max()))

fit = clothfit.estimate(guess, target=[motion, (motion, made)], max_evaluations=50, on_progress=lambda progress: None)
if fit.status == "converged" and fit.rmse < 1e-6:
    clothfit.save(fit.scene, "fitted.json")
fit = clothfit.estimate(guess, "target.pc2", budget="30s", rmse=1e-4, on_progress=lambda progress: print(progress.cost))
results = clothfit.estimate_many([guess], ["target.npz"], max_evaluations=50, substeps="auto")
print(repr(results[0].fit), clothfit.evaluate(made, fit.scene, target=Path("target.npz")))


def lowest(motion: clothfit.Motion) -> tuple[float, np.ndarray]:
    return float(motion.positions[-1, 0, 1] ** 2), np.zeros(motion.positions.shape)


def heights(motion: clothfit.Motion) -> tuple[np.ndarray, np.ndarray]:
    return motion.positions[-1, :, 1], np.eye(motion.positions.size)[-48::3]


own = clothfit.estimate(made, objective=lowest, max_evaluations=5)
whole = clothfit.Objective(made)
for x in whole.positions(p):
    print(x.shape, whole.pullback(p, [np.ones_like(x)]).max(), whole.frames)
own = clothfit.estimate(made, objective=clothfit.Residuals(heights), method="gauss-newton")
for block in fit.parameters:
    print(block.name, len(block.at_bound), block.interval[0])

evaluation = clothfit.evaluate(made, fit.scene)
print(evaluation.fitted.rmse, [deviation.count for deviation in evaluation.parameters])
target = clothfit.load_motion("target.pc2", scene, reading=clothfit.Reading(up="z", fps=24.0))
clothfit.save_motion(target, "target.npz", scene, clothfit.Convention(scale=0.01))
print([problem.sentence for problem in clothfit.mesh_problems.problems(clothfit.weld.weld(sheet).mesh)])
assert clothfit.verify.check(clothfit.Objective(guess, motion), p).passed
try:
    clothfit.energies(made, motion).total.max()
except clothfit.Diverged as error:
    print(error.step, error.exit_code)
"""


def checked(folder, script):
    """What `mypy --strict` says of a script in a folder of its own, where only the installed package is to be seen."""
    (folder / "script.py").write_text(script, "utf-8")
    installed = str(Path(clothfit.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([installed, os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "script.py"]
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
        'motion.positions = p\n'
        'clothfit.estimate(made, presicion=1.0)\n'
        'clothfit.estimate(made, objective=lambda motion: 1.0)\n'
    )
    return checked(tmp_path_factory.mktemp("types"), f"{SCRIPT}\n{names}\n{wrong}")


def lines(output, kind):
    """The numbers of the lines of which it says something of a kind."""
    return [int(line) for line in re.findall(rf"^script\.py:(\d+): {kind}:", output, re.MULTILINE)]


def test_a_strict_type_checker_finds_nothing_wrong_with_calls_that_are_right(output):
    assert [line for line in lines(output, "error") if line <= SCRIPT.count("\n")] == [], output


def test_it_knows_the_type_of_every_public_name(output):
    types = re.findall(r'Revealed type is "(.*)"', output)
    assert len(types) == len(clothfit.__all__)
    assert [kind for kind in types if kind == "Any"] == []


def test_it_finds_calls_that_are_wrong(output):
    last = SCRIPT.count("\n") + len(clothfit.__all__) + 2
    assert sorted(set(lines(output, "error"))) == [last + k for k in (1, 2, 3, 4, 5, 6)], output
