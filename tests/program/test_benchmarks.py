"""The benchmarks compare equals: every peer computes the motion and the gradient that this program does."""

import json
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from helpers import physics
from helpers.paths import BENCHMARKS
from helpers.physics import TIGHT as ROUNDING
from helpers.scenes import cloth, load_text, sphere, trial, write_scene

import clothfit
from clothfit.derivative import adjoint
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.scene.forces import Forces

pytestmark = pytest.mark.slow  # compiles a fit

TIGHT = 1e-13
WINDY = {"windVel": {"x": 3.0, "y": 1.0, "z": -2.0}, "dragCoefficient": 0.5}
LIBRARIES = ("this program", "cpp", "scipy", "jax", "torch", "warp")  # numba's takes 7 s; `speed.py` judges all


@pytest.fixture(autouse=True)
def benchmarks(monkeypatch):
    """The folder of the scripts on the path, as when they are run; their short names are forgotten afterwards, but that
    of the one that compiles.
    """
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    yield
    own = {path.stem for path in BENCHMARKS.glob("*.py")} - {"approximate"} | {"peers"}
    for name in [name for name in sys.modules if name.split(".")[0] in own]:
        del sys.modules[name]


def scene():
    """A windy cloth that begins with a push."""
    push = [{"x": 0.1 * i, "y": 0.2, "z": -0.1} for i in range(16)]
    return load_text(json.dumps(trial("nL", frames=7, vertVel=push, **WINDY)))


def peer(name, of):
    if name == "this program":
        return import_module("peers.this_program").Peer(of)
    if name != "cpp":
        pytest.importorskip(name)
    file, problem = import_module("measure").PEERS[name], import_module("peers.problem").problem(of)
    try:
        return import_module(f"peers.{file}").Peer(problem)
    except ImportError as reason:  # no compiler
        pytest.skip(str(reason))


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_peer_has_the_motion_and_the_gradient_that_this_program_has(name):
    of = scene()
    other, target = peer(name, of), clothfit.simulate(of, tolerance=TIGHT)
    # Solves to 1e-13 of momenta of about 1 m/s, 6 steps: 1e-13 m; a thousand times as much for rounding and condition.
    assert other.steps(6, TIGHT) == pytest.approx(target.positions, abs=1e-10)
    if name == "scipy":  # which has no gradient
        return
    k = 1.2 * clothfit.parameters(of)
    cost, gradient = clothfit.cost_and_gradient(clothfit.with_parameters(of, k), target, TIGHT)
    found, slope = other.cost_and_gradient(k, target.positions, TIGHT)
    # Solves to 1e-13 in both; the rest is what the systems' condition, below 1e3, may make of it.
    assert found == pytest.approx(cost, rel=1e-10)
    assert slope == pytest.approx(gradient, rel=1e-9, abs=1e-9 * np.abs(gradient).max())


def test_peers_refuse_what_they_leave_out():
    with pytest.raises(ValueError, match="no spheres"):
        import_module("peers.problem").problem(load_text(json.dumps(trial("nL", colliders=[sphere()]))))


def test_a_program_that_computes_something_else_is_not_quoted(tmp_path, monkeypatch, capsys):
    speed, module = import_module("speed"), import_module("peers.scipy_peer")
    path = Path(write_scene(tmp_path, trial("nL", frames=4)))
    speed.programs_table(path, ["scipy"], 1)
    assert "| SciPy |" in capsys.readouterr().out
    right = module.Peer.steps
    monkeypatch.setattr(module.Peer, "steps", lambda self, n, tolerance: right(self, n, tolerance) + 1e-6)
    speed.programs_table(path, ["scipy"], 1)
    printed = capsys.readouterr()
    assert "| clothfit |" in printed.out
    assert "| SciPy |" not in printed.out
    assert "SciPy: left out" in printed.err


def test_the_approximate_adjoint_is_that_of_stored_matrices():
    """One is the sweep of the program, the other is written down from its equations with SciPy's matrices."""
    made, task = import_module("stored_matrices"), import_module("open_loop").Task
    own = task(made.sheet(4), 8)
    motion = own.simulated(np.random.default_rng(1).normal(scale=0.1, size=(8, 16, 3)), TIGHT)
    weight = np.random.default_rng(2).normal(size=motion.x.shape)
    weight[np.setdiff1d(range(9), own.keys)] = 0.0
    found = own.back(import_module("open_loop").SWEEPS["approximate"], motion, weight[own.keys], TIGHT)
    # both solve to rounding; the sizes of the numbers cancel in h K λ to 1e-3 of themselves
    other = made.swept(own, motion, made.stored(own, motion), weight)
    np.testing.assert_allclose(other, found, rtol=0, atol=1e-10 * np.abs(found).max())


def test_descents_of_the_open_loop_end_at_one_minimum():
    """A short motion has but one; what is left is where they end."""
    own = import_module("open_loop")
    cost = []
    for method in ("L-BFGS", "Gauss–Newton"):
        descent = own.Descent(own.Task(import_module("stored_matrices").sheet(4), 6), own.SWEEPS["exact"], np.inf)
        cost.append(own.METHODS[method](descent).cost)
        assert cost[-1] < 0.9 * descent.values[0]
    assert cost[0] == pytest.approx(cost[1], rel=1e-4)


# --- the gradient of textbooks: where it is the exact one, and its transpose

STEPS = 12


def pushed(drag, damping, **fields):
    """A cloth of 3 × 3 vertices, two held, on which random forces act, its motion and a weight on the positions."""
    made = cloth(3, 3, vertMass=[0.1] * 9, dragCoefficient=drag, damping=damping)
    own = physics.scene(made, **{"delta": 0.01, **fields})
    rng = np.random.default_rng(3)
    forces = Forces(own.delta * np.arange(STEPS), rng.normal(size=(STEPS, 9, 3)))
    system = build(own.with_forces(forces), 0, steps=STEPS)
    memory, good = rollout(system, STEPS, ROUNDING)
    assert good == STEPS
    return system, memory, rng.normal(size=memory.x.shape)


def test_the_same_where_the_step_is_fully_implicit():
    """Newton's method ends at the step whose adjoint this is. The Jacobians are those of the iteration before, which is
    √1e-14 off as the method is of second order. One iteration alone is far off.
    """
    error, approximate = [], import_module("approximate")
    for newton in (1, 12):
        given = (*pushed(0.0, 0.0, delta=0.02, forwardSubSteps=newton), ROUNDING, ("force",))
        error.append(physics.relative(*(each.gradient(*given).force for each in (adjoint, approximate))))
    assert error[0] > 1e-3
    assert error[1] < 1e-6
