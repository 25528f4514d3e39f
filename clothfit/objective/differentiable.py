"""What users have of an objective: motion and cost as functions of the parameters, with exact derivatives.

    x(p): the positions that p gives;   G(p) = c(x(p));   J = ∂x/∂p

J is never formed. `tangent` gives J d for a direction d, `pullback` gives Jᵀ w for a weight w of each position, each in
the time of a few simulations. `pullback` is the vector–Jacobian product that frameworks of automatic differentiation
ask for: with it a loss of PyTorch or JAX goes back through the simulation (`examples/with_torch.py`,
`examples/with_jax.py`).
"""

from __future__ import annotations

from collections.abc import Sequence

from clothfit.base.arrays import Array, Flags
from clothfit.base.messages import counted
from clothfit.objective import objective as inside
from clothfit.objective.experiment import Targets
from clothfit.objective.memory_needs import Needs
from clothfit.objective.objective import Compared
from clothfit.scene.scene import Scene


class Objective:
    """The cost G(p) of one scene against one or more targets, and the motion x(p), with exact derivatives; prepared
    once, for many p (P,).

    The motion is a list with the positions x (T + 1, n, 3), m, of each run: of each object that is fitted, for each
    target, after every time step. With one object and one target it is a list of one.
    """

    def __init__(
        self,
        scene: Scene,
        motion: Targets | None = None,
        tolerance: float | None = None,
        frames: int | Sequence[int | None] | None = None,
        *,
        objective: Compared = "position",
        loss: str = "linear",
        loss_scale: float | None = None,
        memory: int | str | None = None,
    ) -> None:
        """Compare with the frames of `motion` that lie within the first `frames` frames of the scene (default: all).

        `motion` is a Motion, the path of a motion file, or an array (frames, vertices, 3), m, with one frame per step;
        a pair of one of these and the scene it was recorded in; or a list of these, with one number of `frames` for all
        or one for each. Another scene must have the same objects; wind, places, fixed vertices and time step may
        differ. `scene` says what is flagged. The arrays are not copied and must not change. Without a motion nothing is
        compared: the cost is 0, and `positions` and its products are those of the scene's frames.

        `objective` is "position", "velocity", "edge-length", "spectrum", or a dict with the weight of each. It may also
        be a cost of one's own: a function that takes a `Motion` of F frames and N vertices, of all objects, and returns
        the cost, at least 0, and its derivative (F, N, 3) by the positions; or `Residuals`. Such a cost sees the motion
        at the times of the target's frames, and needs no target: without one it sees the frames of the scene.

        `loss`, "linear", "soft_l1" or "huber", says how outliers count, `loss_scale`, m, above which length.
        `tolerance` is that of the linear systems, relative (default: 1e-14). `memory` is how much may be held, in bytes
        or as "200MB" (default: half of what is free); it changes no result.

        Raises InvalidMotion when a motion does not fit its scene or an objective, InvalidInput for other arguments.
        """
        self._inside = inside.Objective(
            scene, motion, tolerance, frames, objective=objective, loss=loss, loss_scale=loss_scale, memory=memory
        )

    def __repr__(self) -> str:
        inner = self._inside
        sizes = [
            counted(len(inner.experiments), "target", "targets"), counted(self.frames, "frame", "frames"),
            counted(self.observations, "position", "positions"), counted(len(self.identifiable), "value", "values"),
        ]  # fmt: skip
        return f"<Objective of {inner.scene.name}: {', '.join(inner.weights)}; {', '.join(sizes)}>"

    @property
    def frames(self) -> int:
        """Number of frames that are compared, of all targets together."""
        return self._inside.frames

    @property
    def steps(self) -> int:
        """Number of simulated steps of the longest target."""
        return self._inside.steps

    @property
    def observations(self) -> int:
        """Number of vertex positions that are compared."""
        return self._inside.observations

    @property
    def needs(self) -> Needs:
        """The memory that a gradient takes. Raises InvalidInput when `memory` is too little."""
        return self._inside.needs

    @property
    def identifiable(self) -> Flags:
        """Which values of the fit vector (P,) at least one of the targets can reveal."""
        return self._inside.identifiable

    def until(self, frames: int | Sequence[int], tolerance: float | None = None) -> Objective:
        """The same objective over the first `frames` frames, one number for all targets or one for each, solved to
        another tolerance.
        """
        shorter = Objective.__new__(Objective)
        shorter._inside = self._inside.until(frames, tolerance)
        return shorter

    def cost(self, p: Array) -> float:
        """G(p), m², for p (P,). Raises Diverged."""
        return self._inside.cost(p)

    def cost_and_gradient(self, p: Array) -> tuple[float, Array]:
        """G(p), m², and its exact gradient ∂G/∂p (P,). Raises Diverged."""
        return self._inside.cost_and_gradient(p)

    def positions(self, p: Array) -> list[Array]:
        """The motion x(p): the positions (T + 1, n, 3), m, of each run. Raises Diverged."""
        return self._inside.positions(p)

    def tangent(self, p: Array, direction: Array) -> list[Array]:
        """The Jacobian–vector product J d: change of the positions (T + 1, n, 3), m, of each run along a `direction` d
        (P,) from p (P,). Raises Diverged.
        """
        return self._inside.tangent(p, direction)

    def pullback(self, p: Array, by_position: Sequence[Array]) -> Array:
        """The vector–Jacobian product Jᵀ w (P,) at p (P,), of one weight w (T + 1, n, 3) for each run. Where w is the
        derivative of a function of the motion by its positions, this is the function's gradient by p. Raises Diverged.
        """
        return self._inside.pullback(p, by_position)

    def rmse(self, cost: float) -> float:
        """Root mean square distance, m, of a cost, m²; for other objectives in the unit of what they compare, for a
        cost of one's own its root.
        """
        return self._inside.rmse(cost)

    def position_rmse(self, p: Array) -> float:
        """Root mean square distance of the observed positions at p (P,), m, for any objective; NaN where none is
        observed. Raises Diverged.
        """
        return self._inside.position_rmse(p)
