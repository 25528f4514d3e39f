"""The cost of a whole motion x (T + 1, n, 3), at once: what a running cost must come to, chunk by chunk."""

import numpy as np
from scipy.sparse import csr_array

from clothfit.engine.rollout import rollout
from clothfit.motion.times import interpolation
from clothfit.objective.running_cost import NO_DERIVATIVE
from clothfit.objective.target import accumulate, sample


def cost(made, x):
    """G of a motion."""
    if made.distance_scale is not None:
        return made.distance_scale * float(accumulate(x, made.goal, NO_DERIVATIVE, 0.0))
    return made.cost_of(sample(made.goal, x))


def cost_and_derivative(made, x):
    """G of a motion, and ∂G/∂x (T + 1, n, 3)."""
    if made.distance_scale is not None:
        derivative = np.zeros_like(x)
        value = made.distance_scale * float(accumulate(x, made.goal, derivative, 0.0))
        return value, made.distance_scale * derivative
    s = sample(made.goal, x)
    back = interpolation(made.goal.step, made.goal.fraction, len(x)).T @ made.derivative_of(s).reshape(len(s), -1)
    return made.cost_of(s), back.reshape(x.shape)


def residual(made, x):
    """r (N,) of a motion."""
    return made.residual_of(sample(made.goal, x))


def jacobian(made, x):
    """J (N, 3 n (T + 1)) of a motion, columns in the order of x."""
    whole = made.jacobian_of(sample(made.goal, x))
    return csr_array((whole.data, whole.indices, whole.indptr), shape=(whole.shape[0], x.size))


def simulate_all(objective, run, p):
    """The system of a run at p (P,), and its motion with all states kept."""
    system = run.changed(p)
    memory, good = rollout(system, run.steps, objective.tolerance)
    assert good == run.steps
    return system, memory
