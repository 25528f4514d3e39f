"""The gradient through a window beside that of JAX, which shares no code with it."""

import numpy as np
import pytest

from clothfit.subspace.network import prior
from clothfit.subspace.network.layers import Loss, Trained, gradient
from clothfit.subspace.network.recipe import RECIPES
from clothfit.subspace.network.windows import Motions

jax = pytest.importorskip("jax")


@pytest.mark.parametrize("name", ["own", "paper"])
def test_the_gradient_is_that_of_automatic_differentiation(name):
    jax.config.update("jax_enable_x64", True)
    jnp, recipe = jax.numpy, RECIPES[name]
    rng = np.random.default_rng(0)
    r, m, length = 6, 3, 12
    z = np.cumsum(rng.standard_normal((5, 40, r)), axis=1)
    w = rng.standard_normal((5, 38, m))
    given = Motions(z, w, np.ones((5, 40), bool))
    linear = (prior.dense if recipe.dense else prior.diagonal)(given)
    reach = 1.05 * np.abs(z).max()  # some frames are clipped
    own = Trained(linear, recipe, np.array([[-reach] * r, [reach] * r]), rng, np.float64)
    some, inputs = given.windows(given.starts(length)[0][::11], length)
    begin = some[:, :2] + 0.1 * rng.standard_normal(some[:, :2].shape)
    loss = Loss(recipe.absolute, 3.0)

    def clip(x):  # its derivative is not that of a clip, but what the descent asks for
        inside = jnp.clip(x, -reach, reach)

        @jax.custom_vjp
        def through(x):
            return jnp.clip(x, -reach, reach)

        def back(x, g):
            return (jnp.where(((x < -reach) & (g > 0)) | ((x > reach) & (g < 0)), 0.0, g),)

        through.defvjp(lambda x: (through(x), x), back)
        return through(x) + 0.0 * inside

    def error(values):
        count = len(own.weights)
        weights, biases = values[:count], values[count : 2 * count]
        matrix, offset = values[2 * count :] if recipe.dense else (own.linear, own.offset)
        z2, z1, before, away, ways = begin[:, 0], begin[:, 1], begin[:, 1] - some[:, 1], [], []
        for k in range(length):
            u = jnp.concatenate([z1, z1 - z2, inputs[:, k]], axis=1)
            h = (u - own.mean) * own.lift if own.lift.ndim == 1 else (u - own.mean) @ own.lift
            for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
                h = (jax.nn.relu if recipe.activation == "relu" else jax.nn.elu)(h @ weight + bias)
            made = clip(u @ matrix + offset + own.left * (h @ weights[-1] + biases[-1]))
            z2, z1 = z1, made
            away.append(made - some[:, k + 2])
            ways.append(away[-1] - before)
            before = away[-1]
        total = 0.0
        for part, weight in ((jnp.stack(away, 1), 1.0), (jnp.stack(ways, 1), loss.velocity)):
            norm = jnp.abs(part) if recipe.absolute else jnp.sqrt((part**2).sum(axis=2) + 1e-12)
            total = total + weight * norm.mean()
        return total

    value, grad = gradient(own, loss, some, inputs, begin)
    expected, by = jax.value_and_grad(error)([jnp.asarray(each) for each in own.values])
    np.testing.assert_allclose(value, expected, rtol=1e-12)
    for ours, theirs in zip(grad, by, strict=True):
        # double precision: sums of some hundred terms, that partly cancel
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11 * float(np.abs(theirs).max()))
