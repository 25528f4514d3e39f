"""A simulation as a function of PyTorch, and a cost of one's own that PyTorch differentiates.

`python examples/with_torch.py` needs `pip install torch` (the build for the CPU will do). The parameters p (P,) are
float64 throughout; single precision would spoil the gradient.
"""

import torch

import clothfit


class Simulation(torch.autograd.Function):
    """The motion x(p), (T + 1, n, 3) in m, of a scene with one object, with its exact vector–Jacobian product."""

    @staticmethod
    def forward(ctx, p, objective):
        """Simulate with the values p (P,)."""
        ctx.save_for_backward(p)
        ctx.objective = objective
        (x,) = objective.positions(p.detach().numpy())
        return torch.from_numpy(x)

    @staticmethod
    def backward(ctx, by_position):
        """Jᵀ w of the derivative w (T + 1, n, 3) of a loss by the positions; none by the objective."""
        (p,) = ctx.saved_tensors
        return torch.from_numpy(ctx.objective.pullback(p.numpy(), [by_position.contiguous().numpy()])), None


def curtain():
    """A curtain of 4 × 4 vertices, 1 m × 1 m, held at its upper side in the wind; each stiffness is fitted."""
    sheet = clothfit.mesh.plane(2, 1.0, upright=True)
    held = sheet.positions[:, 1] > 0.49
    return clothfit.new_scene(sheet, held, wind=(0, 0, 2), drag=50, frames=20, fit="nL")


def train(scene, target, steps=25):
    """A model inside PyTorch: two numbers, a stiffness and its slope from top to bottom, give all stiffnesses. L-BFGS
    fits them through the simulation; returns the losses, mm².
    """
    objective = clothfit.Objective(scene)
    cloth = scene.cloths[0]
    height = torch.from_numpy(cloth.positions[cloth.springs, 1].mean(axis=1))  # of each spring, m
    start, wanted = torch.from_numpy(clothfit.parameters(scene)), torch.from_numpy(target.positions)
    coefficients = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([coefficients], max_iter=steps, line_search_fn="strong_wolfe")
    losses = []

    def loss():
        optimiser.zero_grad()
        p = start * torch.exp(coefficients[0] + coefficients[1] * height)
        found = 1e6 * ((Simulation.apply(p, objective) - wanted) ** 2).sum(dim=2).mean()
        found.backward()
        losses.append(found.item())
        return found

    optimiser.step(loss)
    return losses


def sag(motion):
    """A cost of one's own: how far the lowest point of the whole motion is from 0.6 m below the middle, m². The lowest
    is taken smoothly, and PyTorch differentiates.
    """
    x = torch.tensor(motion.positions, requires_grad=True)
    lowest = -torch.logsumexp(-200.0 * x[:, :, 1].flatten(), dim=0) / 200.0
    cost = (lowest + 0.6) ** 2
    cost.backward()
    return cost.item(), x.grad.numpy()


def main():
    """Show both ways."""
    scene = curtain()
    truth = clothfit.with_parameters(scene, 1.5 * clothfit.parameters(scene))
    losses = train(scene, clothfit.simulate(truth, tolerance=1e-10))
    print(f"the layer: loss {losses[0]:.3g} mm² → {losses[-1]:.3g} mm²")
    before, _ = sag(clothfit.simulate(scene))
    fit = clothfit.estimate(scene, model="F", options=clothfit.FitOptions(objective=sag, rmse=1e-4))
    print(f"the cost of one's own: {before:.3g} → {fit.cost:.3g} m², {fit.status}")


if __name__ == "__main__":
    main()
