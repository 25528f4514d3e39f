"""A cost of one's own: any function of the motion, with its derivative.

    G(p) = c(x(p)),   ∂G/∂p = (∂x/∂p)ᵀ ∂c/∂x

The function is given a motion s (F, N, 3) of all N vertices at the times of the target's F frames and returns c, at
least 0, and ∂c/∂s. The exact adjoint does the rest. As least squares, c = Σ r², it returns r (R,) and ∂r/∂s instead
(`Residuals`), with which Gauss–Newton can fit.

A cost may join several objects. Their motions are then simulated first; the derivative of each is that of the common
cost, with the others where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.motion.motion import Motion, in_groups
from clothfit.motion.simulate import simulate_cloths
from clothfit.objective.comparison import MATRIX_ENTRY, OWN, Comparison, Loss, by_state
from clothfit.objective.target import Target, sample
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from scipy.sparse import csr_array

OwnCost: TypeAlias = Callable[[Motion], tuple[Any, npt.ArrayLike]]
"""A function of a motion of F frames and N vertices that returns a cost, at least 0, and its derivative (F, N, 3) by
the positions; numbers and arrays may be of any library that NumPy reads."""


@dataclass(frozen=True)
class Residuals:
    """Residuals of one's own, for the `objective` of a fit: its cost is the sum of their squares.

    `function` takes a `Motion` of F frames and N vertices and returns the residuals r (R,) and their derivative
    (R, 3 F N) by the positions in memory order, an array or a sparse matrix of SciPy. Calling the object gives the cost
    and its derivative (F, N, 3). Raises InvalidInput where the function returns something else.
    """

    function: Callable[[Motion], tuple[npt.ArrayLike, Any]]  # motion → r (R,), ∂r/∂x (R, 3 F N)

    def __call__(self, motion: Motion) -> tuple[float, Array]:
        r, J = self.linearised(motion)
        return float(r @ r), np.asarray(2.0 * (J.T @ r)).reshape(motion.positions.shape)

    def linearised(self, motion: Motion) -> tuple[Array, csr_array]:
        """The residuals (R,) and their derivative (R, 3 F N)."""
        from scipy.sparse import csr_array

        try:
            r, J = self.function(motion)
            values, matrix = np.asarray(r, np.float64), csr_array(J, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise wrong("residuals (R,) and their derivative (R, 3 F N)", f"it returned neither: {error}") from None
        if values.ndim != 1 or matrix.shape != (len(values), motion.positions.size):
            found = f"they have the shapes {values.shape} and {matrix.shape}"
            raise wrong(f"residuals (R,) and their derivative (R, {motion.positions.size})", found)
        return values, matrix


def wrong(needed: str, found: str) -> InvalidInput:
    """The error of a function that returns something else."""
    return InvalidInput(f"objective: the function must return {needed}; {found}")


def evaluated(cost: OwnCost, motion: Motion) -> tuple[float, Array]:
    """A cost of one's own and its derivative (F, N, 3), checked. Raises InvalidInput."""
    shape = motion.positions.shape
    needed = f"a cost and its derivative {shape}"
    found = cost(motion)
    try:
        value, derivative = found
        value, derivative = float(value), np.asarray(derivative, np.float64)
    except (TypeError, ValueError) as error:
        raise wrong(needed, f"it returned neither: {error}") from None
    if derivative.shape != shape:
        raise wrong(needed, f"the derivative has the shape {derivative.shape}")
    if value < 0:
        raise wrong("a cost of at least 0", f"it returned {value:g}; add a constant, so that a fit knows its end")
    return value, derivative


class Whole:
    """The motion of all objects at the times of the frames of one target, and the cost of it."""

    def __init__(self, cost: OwnCost, scene: Scene, motion: Motion, goal: Target, fitted: list[int]) -> None:
        """`goal` is the part of the `motion` of any of the `fitted` objects; the others move as the scene says."""
        self.cost, self.scene, self.goal, self.fitted = cost, scene, goal, fitted
        times = motion.times[: len(goal.step)]
        still = np.concatenate([cloth.positions for cloth in scene.cloths])
        self.motion = Motion(np.tile(still, (len(times), 1, 1)), times, scene.vertex_counts, name=scene.name)
        self.groups = in_groups(self.motion, scene)  # the same positions
        self._others_moved = sum(len(scene.together(cloth)) for cloth in fitted) == len(scene.cloths)
        self._last: tuple[Array, float, Array] | None = None

    def place(self, cloth: int, states: Array) -> None:
        """Put an object where it is at the frames (F, n, 3)."""
        self.groups.of(cloth)[:] = states

    def now(self) -> Motion:
        """The motion as it is, for a function that may keep it. Raises Diverged where another object diverges."""
        if not self._others_moved:
            others = [cloth for cloth in range(len(self.scene.cloths)) if cloth not in self.fitted]
            moved = simulate_cloths(self.scene, others, self.goal.last_step + 1)
            for cloth in others:
                self.place(cloth, sample(self.goal, np.ascontiguousarray(moved.of(cloth))))
            self._others_moved = True
        kept = self.motion
        return Motion(kept.positions.copy(), kept.times, kept.vertex_counts, name=kept.name)

    def evaluated(self) -> tuple[float, Array]:
        """The cost of the motion as it is, and its derivative (F, N, 3); asked for again, it is not computed again."""
        if self._last is None or not np.array_equal(self._last[0], self.motion.positions):
            motion = self.now()
            positions = motion.positions.copy()
            self._last = (positions, *evaluated(self.cost, motion))
        return self._last[1:]


class OwnComparison(Comparison):
    """One object in a cost of one's own. Its share in the cost is that of each other; its derivative is the whole one.
    """

    def __init__(self, whole: Whole, goal: Target, cloth: int) -> None:
        """`whole` is shared by all objects of a target, `goal` the target's part for this one."""
        self.whole, self.goal, self.cloth, self.loss = whole, goal, cloth, Loss()
        self.scales, self.measures = {OWN: 1.0}, {}
        self.last_step, self.distance_scale, self.plain, self.surface = goal.last_step, None, False, None

    @cached_property
    def total_weight(self) -> float:
        """What G is divided by for a mean: of all objects of a target together 1."""
        return 1.0 / len(self.whole.fitted)

    @property
    def seen(self) -> Flags:
        """Which vertices (n,) may be compared: all."""
        return np.ones(self.goal.observed.shape[1], bool)

    @property
    def jacobian_bytes(self) -> int:
        """Bytes of J while it is made, roughly; 0 where there are no residuals."""
        cost = self.whole.cost
        return MATRIX_ENTRY * int(cost.linearised(self.whole.now())[1].nnz) if isinstance(cost, Residuals) else 0

    def cost_of(self, s: Array) -> float:
        """The share in G of the states s (F, n, 3) at the times of the frames, the other objects where they are."""
        self.whole.place(self.cloth, s)
        return self.whole.evaluated()[0] / len(self.whole.fitted)

    def derivative_of(self, s: Array) -> Array:
        """∂G/∂s (F, n, 3)."""
        self.whole.place(self.cloth, s)
        return np.ascontiguousarray(self.whole.evaluated()[1][:, self.whole.groups.part(self.cloth)])

    def residual_of(self, s: Array) -> Array:
        """r (R,) of the states s (F, n, 3)."""
        return self._linearised(s)[0]

    def jacobian_of(self, s: Array) -> csr_array:
        """J (R, 3 n (T + 1)), T = `last_step`; columns in the order of x."""
        columns = np.arange(self.whole.motion.positions.size).reshape(self.whole.motion.positions.shape)
        own = columns[:, self.whole.groups.part(self.cloth)].ravel()
        return by_state(self.goal, self._linearised(s)[1].tocsc()[:, own].tocsr())

    def _linearised(self, s: Array) -> tuple[Array, csr_array]:
        cost = self.whole.cost
        if not isinstance(cost, Residuals):
            raise InvalidInput("objective: this method needs residuals; give clothfit.Residuals(…)")
        self.whole.place(self.cloth, s)
        return cost.linearised(self.whole.now())


def unseen(scene: Scene, frames: int | None = None) -> Motion:
    """What stands for a target where there is none: the scene's times, with nothing observed."""
    count = scene.frames if frames is None else frames
    vertices = sum(scene.vertex_counts)
    positions, observed = np.full((count, vertices, 3), np.nan), np.zeros((count, vertices), bool)
    times = scene.delta * np.arange(count, dtype=np.float64)
    return Motion(positions, times, scene.vertex_counts, observed, scene.name)
