"""The pins of a reduced motion, and their mean, at a step: `Reduced.iteration` and `Reduced.places`, compiled.

`pins` (5, P + 1, 3): y, u and w as an iteration takes them, and x, v where the step begins; `fixed` is that of `march`.
"""

from __future__ import annotations

from clothfit.kernels.kernel import kernel


@kernel
def place_pins(fixed, pins, t, second, h):
    """Where a step of the pins and their mean begins, their velocities there, and that with which they go on."""
    path = fixed.path
    for p in range(pins.shape[1]):
        for c in range(3):
            x, v = path[t, p, c], velocity(fixed, t, p, c)
            pins[1, p, c] = v
            if second:
                before = velocity(fixed, t - 1, p, c)
                pins[1, p, c] = 2.0 * v - before
                x, v = x + (x - path[t - 1, p, c]) / 3.0, v + (v - before) / 3.0
            pins[2, p, c] = (path[t + 1, p, c] - x) / h
            pins[3, p, c], pins[4, p, c] = x, v


@kernel
def velocity(fixed, t, p, c):
    """A component of the velocity of a pin before step t."""
    path, h = fixed.path, fixed.h
    if t == 0:
        return fixed.v_held[p, c]
    if fixed.second and t > 1:
        return (1.5 * path[t, p, c] - 2.0 * path[t - 1, p, c] + 0.5 * path[t - 2, p, c]) / h
    return (path[t, p, c] - path[t - 1, p, c]) / h


@kernel
def move_pins(pins, h, ahead, again):
    """Where an iteration is linearised: with the velocity of the step where there was one before it (`again`)."""
    for p in range(pins.shape[1]):
        for c in range(3):
            if again:
                pins[1, p, c] = pins[2, p, c]
            pins[0, p, c] = pins[3, p, c] + h * pins[1, p, c] if ahead else pins[3, p, c]
