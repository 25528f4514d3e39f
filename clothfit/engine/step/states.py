"""The states of a `rollout.Rollout`, as steps and what reads them need them."""

from __future__ import annotations

from clothfit.kernels.kernel import kernel


@kernel
def velocity(part, t):
    """Velocity (n, 3) before step t of a Rollout."""
    if t == 0:
        return part.v
    return part.w[t - 1, part.used[t - 1] - 1]


@kernel
def velocities(part, t):
    """Velocities (N, n, 3) of the iterations of step t, as they were before the step was shortened."""
    w, theta = part.w[t], part.theta[t]
    if theta < 1.0:
        w = w.copy()
        last = w[part.used[t] - 1]
        for i in range(len(last)):  # a power of ½: nothing is lost; `last /= theta` would add seconds of compilation
            last[i, 0], last[i, 1], last[i, 2] = last[i, 0] / theta, last[i, 1] / theta, last[i, 2] / theta
    return w


@kernel
def state_before(part, t):
    """Position and velocity (n, 3) one step before step t of a Rollout begins."""
    if t == 0:
        return part.x_before, part.v_before
    return part.x[t - 1], velocity(part, t - 1)
