"""The examples for PyTorch and JAX, where these are installed: their products are derivatives, and they run."""

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.modules import script
from helpers.paths import EXAMPLES

import clothfit

pytestmark = pytest.mark.slow  # loads a framework


def example(name):
    """An example as a module."""
    pytest.importorskip(name.removeprefix("with_"))
    return script(EXAMPLES / f"{name}.py")


@pytest.fixture
def with_torch():
    return example("with_torch")


@pytest.fixture
def with_jax():
    return example("with_jax")


def objective_of(scene):
    """An objective that simulates a scene over a few frames, and values at which it moves."""
    scene = scene.with_step(scene.delta, frames=6)
    return clothfit.Objective(scene), 1.2 * clothfit.parameters(scene)


def test_the_product_for_torch_is_the_derivative(with_torch):
    torch = pytest.importorskip("torch")
    objective, p = objective_of(with_torch.curtain())
    scale = torch.from_numpy(p)
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=(6, 16, 3)))

    def loss(logs):
        x = with_torch.Simulation.apply(scale * torch.exp(logs), objective)
        return (weights * x).sum() + (x**2).sum().sin()

    logs = torch.zeros(len(p), dtype=torch.float64, requires_grad=True)
    # central differences with steps of 1e-5: truncation 1e-10, rounding of x, 1e-15 m, over the step
    assert torch.autograd.gradcheck(loss, (logs,), eps=1e-5, atol=1e-8, rtol=1e-6)


def test_the_product_for_jax_is_the_derivative(with_jax):
    jax = pytest.importorskip("jax")
    from jax.test_util import check_grads

    objective, p = objective_of(with_jax.curtain())
    positions = with_jax.simulation(objective, 16)
    weights = np.random.default_rng(1).normal(size=(6, 16, 3))

    def loss(logs):
        x = positions(p * jax.numpy.exp(logs))
        return (weights * x).sum() + jax.numpy.sin((x**2).sum())

    check_grads(loss, (np.zeros(len(p)),), order=1, modes=["rev"], eps=1e-5, atol=1e-8, rtol=1e-6)
    both = np.stack([np.zeros(len(p)), 0.1 * np.ones(len(p))])
    one_by_one = [jax.grad(loss)(each) for each in both]
    np.testing.assert_allclose(jax.vmap(jax.jit(jax.grad(loss)))(both), one_by_one, rtol=1e-12)


@pytest.mark.parametrize("name", ["with_torch", "with_jax"])
def test_a_model_is_trained_and_a_cost_that_the_framework_differentiates_is_fitted(name, capsys):
    module = example(name)
    scene = module.curtain()
    truth = clothfit.with_parameters(scene, 1.5 * clothfit.parameters(scene))
    losses = module.train(scene, clothfit.simulate(truth, tolerance=1e-10))
    assert losses[-1] < 1e-2 * losses[0]  # the truth is among what the model can say
    objective = clothfit.Objective(scene, objective=module.sag)
    assert clothfit.verify.check(objective, clothfit.parameters(scene)).passed
    fit = estimate(scene, objective=module.sag, model="F", rmse=1e-4)
    assert fit.cost <= 1e-8  # m²: `rmse` is its root

    module.main()
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 2
    assert printed[1].endswith("converged")


def test_the_two_frameworks_agree(with_torch, with_jax):
    motion = clothfit.simulate(with_torch.curtain())
    cost, derivative = with_torch.sag(motion)
    other, by_jax = with_jax.sag(motion)
    assert cost == pytest.approx(float(other), rel=1e-12)
    np.testing.assert_allclose(derivative, by_jax, atol=1e-12 * np.abs(derivative).max())
