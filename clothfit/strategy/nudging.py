"""Nudging: springs pull each vertex of a motion to where it was seen, weaker and weaker.

A motion that forgets where it began, as in wind, has a cost with many minima; one that is held near its target has few.
With springs of m ω² a motion follows what it is shown within about 1 / ω, and what is left is what the model does wrong
in that time:

    m a = f(x, v; p) + m ω² (y − x),    Σ |x − y|² → min.

With a large ω that is the balance of momentum from frame to frame, and with ω = 0 the whole motion; the values that one
pull finds start the next, weaker one. States where windows would begin are estimated on the way: what is not seen is
not pulled, and moves as the model moves it. Weak-constraint 4D-Var balances the same, with the forces as unknowns
(Y. Trémolet, Accounting for an imperfect model in 4D-Var, 2006); for models that are pulled while their values are
fitted see H. D. I. Abarbanel et al., Dynamical state and parameter estimation, 2009.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.strategy.first_windows import some_steps
from clothfit.strategy.pulls import nudged

PULLS = (3.0, 1.0, 0.3, 0.1, 0.03)
"""ω, in radians per frame of the target, one after the other."""

STEPS, EACH = 6, 2
"""Steps of Gauss–Newton with each of them; which of the values that they find start a fit, every so many."""


def through_pulls(own: Search) -> list[Array]:
    """Steps of Gauss–Newton on nudged motions, and then on those of the model alone; returns the values (P,) that
    each pull has found. Raises Stop.
    """
    y, found = own.y, list[Array]()
    for pull in PULLS:
        part = Trajectory(own, nudged(own.objective, pull))
        own.enter("nudging", part.objective)
        if own.is_late:
            break
        if not np.isfinite(part.cost(y)):  # explicit steps are unstable with the stiffest springs
            continue
        y = some_steps(part, y, STEPS)
        found.append(own.parameters(y))
        own.visit(found[-1])
    if found and not own.is_late:
        own.enter("nudging")
        own.visit(own.parameters(some_steps(Trajectory(own, own.objective), y, STEPS)))
    return found
