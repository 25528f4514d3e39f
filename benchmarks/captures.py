"""Captures, by the model that is fitted: `python benchmarks/captures.py TABLE … [--repeats 1]`.

`spoiled`: six sheets as some of their vertices show them, with 1 mm of noise; fitted as they are, and fitted with
`fit_time` and `fit_placement` where the camera is 15 ms late or early, everything is turned by 3° and moved by 3 cm,
and two pairs of markers are swapped. `few`: 20 of the 144 vertices of a sheet, from starts that are far too soft and
too stiff. Errors are over all vertices, also those that no marker shows.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import click
import numpy as np
from scipy.spatial.transform import Rotation

import clothfit
from clothfit.base.arrays import Array
from clothfit.meshes.mesh import Mesh
from clothfit.motion.motion import Motion, as_motion

NOISE, LATE, TURN, AWAY = 1e-3, 0.015, np.radians(3.0), 0.03
FAMILIES, SCATTER = (60.0, 25.0, 3.0), 0.3
"""Stiffnesses along the sides, across and over two vertices, N/m, and how the springs of each scatter."""


class Case(NamedTuple):
    """A sheet, what is held of it, and its capture."""

    rows: int
    columns: int
    size: float  # m
    held: str  # side, corners, all corners
    delta: float  # s
    frames: int
    markers: int
    fps: float
    late: float  # s, negative: early


CASES = (
    Case(10, 10, 1.2, "corners", 0.02, 80, 24, 30.0, LATE), Case(9, 13, 0.7, "side", 0.01, 90, 30, 60.0, LATE),
    Case(14, 14, 3.0, "side", 0.02, 75, 40, 30.0, LATE), Case(11, 11, 2.0, "all corners", 1 / 60, 90, 25, 30.0, -LATE),
    Case(12, 9, 1.5, "side", 1 / 60, 90, 35, 60.0, LATE), Case(16, 16, 5.0, "corners", 0.02, 75, 60, 30.0, -LATE),
)  # fmt: skip
FEW, STARTS = Case(12, 12, 1.0, "side", 0.02, 100, 20, 30.0, 0.0), (0.05, 10.0, 1000.0)


def sheet(case: Case, seed: int) -> clothfit.Scene:
    """The true scene of a case."""
    n, m = case.rows, case.columns
    index = np.arange(n * m).reshape(n, m)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    sides = (case.size * np.linspace(0.0, 1.0, k) for k in (n, m))
    x, z = (each.ravel() for each in np.meshgrid(*sides, indexing="ij"))
    held = {"side": index[0], "corners": index[0, [0, -1]], "all corners": index[[0, 0, -1, -1], [0, -1, 0, -1]]}
    scene = clothfit.new_scene(
        Mesh(np.stack([x, 0.0 * x, z], axis=1), np.stack([a, b, d, d, b, c], axis=1).reshape(-1, 3)),
        np.isin(index.ravel(), held[case.held]), fit="nL", integrator="implicit", delta=case.delta, frames=case.frames,
    )  # fmt: skip
    ends = scene.cloths[0].springs
    apart = np.abs(np.diff(np.stack([ends // m, ends % m]), axis=2))[:, :, 0]
    family = np.where(apart.max(axis=0) > 1, 2, apart.min(axis=0))
    scatter = np.exp(SCATTER * np.random.default_rng(seed).standard_normal(len(ends)))
    return clothfit.with_parameters(scene, np.array(FAMILIES)[family] * scatter)


def captured(
    case: Case, scene: clothfit.Scene, truth: Motion, seed: int
) -> tuple[Motion, Motion, Array, Array, list[set[int]]]:
    """What markers show of a motion, as it is and spoiled; the rotation and the translation that undo the latter's
    place, and its swaps.
    """
    rng = np.random.default_rng(1000 + seed)
    shots = np.arange(0.0, truth.times[-1] - max(case.late, 0.0) + 1e-9, 1.0 / case.fps)
    times = shots + case.late
    before = np.clip(np.floor(times / scene.delta).astype(int), 0, len(truth.times) - 2)
    share = np.clip(times / scene.delta - before, 0.0, 1.0)[:, None, None]
    x = (1.0 - share) * truth.positions[before] + share * truth.positions[before + 1]
    own = np.sort(rng.choice(x.shape[1], case.markers, replace=False))
    seen = np.zeros(x.shape[:2], bool)
    seen[:, own] = True
    noise, shown = NOISE * rng.standard_normal(x.shape), times >= 0.0
    clean = as_motion(scene, np.where(seen[..., None], x + noise, np.nan)[shown], times[shown], seen[shown])
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    R, D = Rotation.from_rotvec(TURN * axis).as_matrix(), AWAY * way
    y = (x - D) @ R + noise
    pairs = rng.permutation(own)[:4].reshape(2, 2)
    for pair in pairs:
        y[:, pair] = y[:, pair[::-1]]
    spoiled = as_motion(scene, np.where(seen[..., None], y, np.nan), shots, seen)
    return clean, spoiled, R, D, [set(pair.tolist()) for pair in pairs]


def off(scene: clothfit.Scene, truth: Motion) -> float:
    """Root mean square distance of a scene's motion from the true one, mm, over all vertices."""
    away = clothfit.simulate(scene, tolerance=1e-9).positions - truth.positions
    return float(1e3 * np.sqrt((away * away).sum(axis=-1).mean()))


def spoiled_captures(repeats: int) -> None:
    """Print the table of spoiled captures."""
    print("| sheet | markers | camera | clean: off the truth | spoiled | clock | place | turn | swaps | seconds |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for number, case in enumerate(CASES):
        for seed in range(number, number + 10 * repeats, 10):
            scene = sheet(case, seed)
            truth = clothfit.simulate(scene, tolerance=1e-10)
            clean, spoiled, R, D, swaps = captured(case, scene, truth, seed)
            start = 0.6 * float(np.exp(np.log(scene.cloths[0].stiffness).mean()))
            plain, began = clothfit.estimate(scene, clean, start=start), time.perf_counter()
            found = clothfit.estimate(
                scene, spoiled, start=start, options=clothfit.FitOptions(fit_time=True, fit_placement=True),
            )
            seconds, known = time.perf_counter() - began, found.registration[0]
            middle = truth.positions[0].mean(axis=0)
            moved = known.rotation @ ((middle - D) @ R) + known.translation - middle
            turned = np.degrees(Rotation.from_matrix(known.rotation @ R.T).magnitude())
            named = [set(swap.vertices) for swap in found.markers[0].swapped] if found.markers else []
            clock = 1e3 * (known.offset + known.rate * case.late)
            print(
                f"| {case.rows} × {case.columns} | {case.markers} at {case.fps:g}/s | {1e3 * case.late:+.0f} ms "
                f"| {off(plain.scene, truth):.2f} mm | {off(found.scene, truth):.2f} mm | {clock:.2f} ms "
                f"| {1e3 * np.linalg.norm(moved):.2f} mm | {turned:.3f}° | {sum(s in named for s in swaps)} of 2 "
                f"| {plain.seconds:.0f}, {seconds:.0f} |", flush=True,
            )  # fmt: skip


def few_markers(repeats: int) -> None:
    """Print the table of few markers."""
    print("| start, N/m | draw | markers | off the truth | intervals that hold the truth | evaluations | seconds |")
    print("|---|---|---|---|---|---|---|")
    for start in STARTS:
        for seed in range(repeats):
            scene = sheet(FEW, seed)
            truth = clothfit.simulate(scene, tolerance=1e-10)
            share = FEW.markers / truth.positions.shape[1]
            target = clothfit.degrade(truth, NOISE, observed=share, seed=seed, fps=FEW.fps)
            fit = clothfit.estimate(scene, target, start=start)
            ends = [pair for part in fit.parameters for pair in part.interval or ()]
            low, high = np.array([pair or (-np.inf, np.inf) for pair in ends]).reshape(-1, 2).T
            true = scene.cloths[0].stiffness
            held = f"{100 * np.mean((low <= true) & (true <= high)):.0f} %" if len(low) == len(true) else "–"
            print(
                f"| {start:g} | {seed} | {1e3 * fit.rmse:.2f} mm | {off(fit.scene, truth):.2f} mm | {held} "
                f"| {fit.evaluations} | {fit.seconds:.0f} |", flush=True,
            )  # fmt: skip


TABLES = {"spoiled": spoiled_captures, "few": few_markers}


@click.command()
@click.argument("tables", nargs=-1, type=click.Choice(list(TABLES)))
@click.option("--repeats", default=1, show_default=True, help="Draws of each case.")
def main(tables: tuple[str, ...], repeats: int) -> None:
    """Fit captures and print how far the results are from the truth."""
    for name in tables or TABLES:
        TABLES[name](repeats)


if __name__ == "__main__":
    main()
