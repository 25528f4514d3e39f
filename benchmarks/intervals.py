"""How often 95 % intervals contain the truth: `python benchmarks/intervals.py [--repeats 4]`.

Noisy targets of a cloth of 5 × 5 vertices, simulated by the model that is fitted: masses, stiffnesses or both, one
factor for the cloth (F) or one for each vertex and spring (L), of a uniform fabric and of values that scatter. Each
repeat has another truth and other noise. No residual of such a fit is more than noise, so a verdict `differs` is false.
"""

from __future__ import annotations

import itertools

import click
import numpy as np

import clothfit
from clothfit.fit.estimate import record_target
from clothfit.meshes.mesh import Mesh

SIDE, NOISE, FRAMES, SCATTER = 5, (2e-4, 1e-3, 5e-3), (30, 100), 0.3
CASES = [*itertools.product(("Fn", "nF", "Ln", "nL", "LL"), (False,)), *itertools.product(("Ln", "nL", "LL"), (True,))]
"""What is fitted, and whether the true values scatter."""


def cloth(settings: str, frames: int) -> clothfit.Scene:
    """A sheet of 0.4 m, held at two corners."""
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    x, z = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(0.0, 0.4, SIDE)]))
    held = np.isin(np.arange(SIDE * SIDE), (0, SIDE - 1))
    mesh = Mesh(np.stack([x, 0.0 * x, z], axis=1), triangles)
    return clothfit.new_scene(mesh, held, fit=settings, integrator="implicit", delta=0.02, frames=frames)


@click.command()
@click.option("--repeats", default=4, show_default=True, help="Truths of each case.")
def main(repeats: int) -> None:
    """Fit noisy targets and count intervals that contain the truth."""
    print("| fits | truth | frames | noise | number | called another model | intervals | contain the truth |")
    print("|---|---|---|---|---|---|---|---|")
    total = np.zeros(4, int)
    for (settings, scatters), frames, noise in itertools.product(CASES, FRAMES, NOISE):
        scene, sums = cloth(settings, frames), np.zeros(4, int)
        start = clothfit.parameters(scene)
        for seed in range(repeats):
            rng = np.random.default_rng(seed)
            wide = np.where(scatters, SCATTER, 0.0) * rng.standard_normal(len(start)) + 0.3 * rng.standard_normal()
            true = start * np.exp(wide)
            truth = clothfit.with_parameters(scene, true)
            fit = clothfit.estimate(scene, clothfit.degrade(record_target(truth), noise, seed=seed))
            ends = [each for block in fit.parameters for each in block.interval]
            known = [(each, value) for each, value in zip(ends, true, strict=True) if each is not None]
            wrong = fit.verdict is not None and fit.verdict.differs
            sums += (1, wrong, len(known), sum(low <= value <= high for (low, high), value in known))
        total += sums
        fits, wrong, count, inside = sums
        kind = "scatters" if scatters else "uniform"
        print(
            f"| {settings} | {kind} | {frames} | {1e3 * noise:g} mm | {fits} | {wrong} | {count} "
            f"| {inside / max(count, 1):.0%} |",
            flush=True,
        )
    fits, wrong, count, inside = total
    print(f"| all | | | | {fits} | {wrong} | {count} | {inside / max(count, 1):.1%} |")


if __name__ == "__main__":
    main()
