"""A simulation as a function of JAX, under `jit`, `grad` and `vmap`, and a cost of one's own that JAX differentiates.

`python examples/with_jax.py` needs `pip install jax`. The parameters p (P,) are float64 throughout; single precision
would spoil the gradient.
"""

import jax
import jax.numpy as jnp
import numpy as np

import clothfit

jax.config.update("jax_enable_x64", True)


def simulation(objective, vertices):
    """The motion x(p), (T + 1, n, 3) in m, of a scene with one object of n `vertices`, as a function of JAX with its
    exact vector–Jacobian product.
    """
    motion = jax.ShapeDtypeStruct((objective.steps + 1, vertices, 3), np.float64)

    def simulated(p):
        (x,) = objective.positions(np.asarray(p))
        return x

    def pulled_back(p, by_position):
        return objective.pullback(np.asarray(p), [np.asarray(by_position)])

    @jax.custom_vjp
    def positions(p):
        return jax.pure_callback(simulated, motion, p, vmap_method="sequential")

    def forward(p):
        return positions(p), p

    def backward(p, by_position):
        like = jax.ShapeDtypeStruct(p.shape, p.dtype)
        return (jax.pure_callback(pulled_back, like, p, by_position, vmap_method="sequential"),)

    positions.defvjp(forward, backward)
    return positions


def curtain():
    """A curtain of 4 × 4 vertices, 1 m × 1 m, held at its upper side in the wind; each stiffness is fitted."""
    sheet = clothfit.mesh.plane(2, 1.0, upright=True)
    held = sheet.positions[:, 1] > 0.49
    return clothfit.new_scene(sheet, held, wind=(0, 0, 2), drag=50, frames=20, fit="nL")


def train(scene, target, steps=40):
    """A model inside JAX: two numbers, a stiffness and its slope from top to bottom, give all stiffnesses. Descent by
    the sign of the gradient fits them through the simulation; returns the losses, mm².
    """
    cloth = scene.cloths[0]
    positions = simulation(clothfit.Objective(scene), len(cloth.mass))
    height = jnp.asarray(cloth.positions[cloth.springs, 1].mean(axis=1))  # of each spring, m
    start, wanted = jnp.asarray(clothfit.parameters(scene)), jnp.asarray(target.positions)

    def loss(coefficients):
        p = start * jnp.exp(coefficients[0] + coefficients[1] * height)
        return 1e6 * ((positions(p) - wanted) ** 2).sum(axis=2).mean()

    value_and_gradient = jax.jit(jax.value_and_grad(loss))
    coefficients, losses = jnp.zeros(2), []
    for step in range(steps):
        value, gradient = value_and_gradient(coefficients)
        losses.append(float(value))
        coefficients -= 0.1 * 0.9**step * jnp.sign(gradient)
    return losses


@jax.jit
@jax.value_and_grad
def too_high(x):
    """How far the lowest point of positions x (F, n, 3) is from 0.6 m below the middle, smoothly, m²."""
    return (0.6 - jax.nn.logsumexp(-200.0 * x[:, :, 1]) / 200.0) ** 2


def sag(motion):
    """The same as a cost of one's own: what JAX gives is what an `objective` returns."""
    return too_high(motion.positions)


def main():
    """Show both ways."""
    scene = curtain()
    truth = clothfit.with_parameters(scene, 1.5 * clothfit.parameters(scene))
    losses = train(scene, clothfit.simulate(truth, tolerance=1e-10))
    print(f"the function: loss {losses[0]:.3g} mm² → {losses[-1]:.3g} mm²")
    before, _ = sag(clothfit.simulate(scene))
    fit = clothfit.estimate(scene, model="F", options=clothfit.FitOptions(objective=sag, rmse=1e-4))
    print(f"the cost of one's own: {before:.3g} → {fit.cost:.3g} m², {fit.status}")


if __name__ == "__main__":
    main()
