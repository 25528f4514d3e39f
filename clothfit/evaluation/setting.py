"""Settings to simulate a scene with: integrator, time step, tolerance of the linear systems, Newton iterations."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from clothfit.engine.system import BDF2, IMPLICIT
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene

EXPLICIT_RATIOS = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32)
"""Steps of the explicit integrators to try, relative to the scene's delta; they are stable only when short."""
IMPLICIT_RATIOS = (4.0, 2.0, 1.0, 1 / 2, 1 / 4, 1 / 8)
"""Steps of the implicit integrator and of BDF2 to try; powers of two, so they reach the frames without rounding."""
TOLERANCES = (1e-3, 1e-5, 1e-8)
NEWTON_COUNTS = (1, 2, 4)


@dataclass(frozen=True)
class Setting:
    """An integrator with its step and accuracy."""

    integrator: str  # one of INTEGRATORS
    ratio: float  # h over the scene's delta
    tolerance: float | None  # of the linear systems, relative; None: it solves none
    newton: int | None  # iterations per step; None: it makes none

    def applied(self, scene: Scene) -> Scene:
        """The scene with this setting."""
        method = INTEGRATORS.index(self.integrator)
        return replace(scene, method=method, delta=self.ratio * scene.delta, newton_iterations=self.newton or 1)

    def steps(self, frames: int) -> int:
        """Number of steps that reach the last of `frames` frames of the scene's delta, or go beyond it."""
        return math.ceil((frames - 1) / self.ratio)

    @property
    def step_name(self) -> str:
        """Its step in terms of the scene's delta, h: 4 h, h, h/4."""
        if self.ratio < 1.0:
            return f"h/{round(1.0 / self.ratio)}"
        return "h" if self.ratio == 1.0 else f"{self.ratio:g} h"

    @property
    def kind(self) -> tuple[str, float | None, int | None]:
        """All but the step."""
        return self.integrator, self.tolerance, self.newton


def own(scene: Scene) -> Setting:
    """The scene's own setting, with which the editor plays it."""
    solves = scene.method in (IMPLICIT, BDF2)
    tolerance, newton = (scene.tolerance, scene.newton_iterations) if solves else (None, None)
    return Setting(INTEGRATORS[scene.method], 1.0, tolerance, newton)


def grid(scene: Scene) -> list[Setting]:
    """The settings to try, including the scene's own: integrators in turn, long steps before short ones."""
    found = [Setting(name, ratio, None, None) for name in INTEGRATORS[:IMPLICIT] for ratio in EXPLICIT_RATIOS]
    # scenes write 1e-5 as a float32 in full, which is not exactly 1e-5
    others = [t for t in TOLERANCES if not math.isclose(t, scene.tolerance, rel_tol=1e-3)]
    tolerances = sorted([scene.tolerance, *others], reverse=True)
    iterations = sorted({scene.newton_iterations, *NEWTON_COUNTS})
    once = sorted({scene.newton_iterations, 1}) if scene.method == BDF2 else [1]  # more gain nothing: see `step.bdf2`
    found += [
        Setting(INTEGRATORS[method], ratio, tolerance, newton)
        for method, counts in ((IMPLICIT, iterations), (BDF2, once))
        for newton in counts
        for tolerance in tolerances
        for ratio in IMPLICIT_RATIOS
    ]
    return found
