"""Print the founding study's experiments beside the study's own numbers: `python benchmarks/study.py [TABLE …]`.

Tables: `experiments` (three scenes, four things to fit), `frames` (from 20 to 200 of them), `noise` (and vertices that
are not seen), `families` (one factor for each, or one value for each spring). Errors are root mean square distances in
metres; the study divides by the count of parameters instead, its numbers are converted. The truth is hidden from each
fit, but for its proportions: examples are of one fabric, so a second row of `noise` scatters every stiffness about it
by a third. Seconds are of the whole fit on a compiled program; in `families` of computing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import clothfit
from clothfit.base.messages import metres

EXAMPLES = Path(__file__).parent.parent / "examples"
SETTINGS = ("Gn", "Ln", "nG", "nL")
STUDY = {
    "side": ((0.201, 49), (0.92, 73), (0.041, 109), (0.082, 90)),
    "corners": ((0.068, 130), (0.051, 73), (0.084, 68), (0.24, 225)),
    "flag": ((3.37, 2), (1.8, 186), (1.18, 82), (0.46, 183)),
}
"""Error, m, and seconds of the study, by scene, in the order of SETTINGS."""

STUDY_FRAMES = {
    ("side", 20): "0.16 (27 s)",
    ("side", 200): "0.05 (2,899 s)",
    ("flag", 20): "0.51",
    ("flag", 60): "120",
    ("flag", 120): "401",
    ("flag", 140): "292",
    ("flag", 200): "292",
}
"""Its sweeps, errors in its own measure: on `side` as fitted, on `flag` over 500 frames."""

FRAMES = (20, 40, 60, 80, 100, 120, 140, 160, 180, 200)
SEEDS, WIDE = range(5), 0.5  # of the factors of families; standard deviation of their logarithms
NOISE, SEEN, SCATTER = (0.0, 1e-4, 1e-3, 5e-3), (1.0, 0.25, 0.05), (0.0, 0.3)


def scene_of(name: str, settings: str, frames: int = 100) -> clothfit.Scene:
    """An example that flags something else."""
    scene = clothfit.load(EXAMPLES / f"{name}.json")
    return replace(scene, frames=frames, cloths=tuple(replace(cloth, settings=settings) for cloth in scene.cloths))


def fitted(scene: clothfit.Scene) -> tuple[clothfit.Fit, clothfit.Evaluation, float]:
    """A trial fit of the scene, its evaluation and its seconds."""
    began = time.perf_counter()
    fit = clothfit.estimate(scene)
    seconds = time.perf_counter() - began
    return fit, clothfit.evaluate(scene, fit.scene), seconds


def experiments() -> None:
    """The twelve experiments: 100 frames of 0.02 s, exact targets."""
    print("| scene | fits | study: error | seconds | here: error | over 500 frames | seconds | ends |")
    print("|---|---|---|---|---|---|---|---|")
    for name, rows in STUDY.items():
        for settings, (error, slow) in zip(SETTINGS, rows, strict=True):
            fit, report, seconds = fitted(scene_of(name, settings))
            print(
                f"| {name} | {settings} | {metres(error)} | {slow} | {metres(fit.rmse)} "
                f"| {metres(report.horizon.rmse)} | {seconds:.2f} | {fit.status} |",
                flush=True,
            )


def frames() -> None:
    """The sweeps over the number of fitted frames, one stiffness per spring."""
    print("| scene | frames | study, its measure | here: error | over 500 frames | seconds |")
    print("|---|---|---|---|---|---|")
    for name in ("side", "flag"):
        for count in FRAMES:
            fit, report, seconds = fitted(scene_of(name, "nL", count))
            theirs = STUDY_FRAMES.get((name, count), "")
            print(
                f"| {name} | {count} | {theirs} | {metres(fit.rmse)} | {metres(report.horizon.rmse)} | {seconds:.2f} |",
                flush=True,
            )


def noise() -> None:
    """`side`, one stiffness per spring, from captures: noise per coordinate, some of the vertices seen."""
    print("| scatter | noise | seen | error to the true motion | over 500 frames | median deviation | seconds |")
    print("|---|---|---|---|---|---|---|")
    generator = np.random.default_rng(0)
    fabric = scene_of("side", "nL")
    factors = np.exp(generator.normal(size=len(fabric.cloths[0].stiffness)))
    for scatter in SCATTER:
        scene = changed(fabric, fabric.cloths[0].stiffness * factors**scatter)
        truth = clothfit.fit.estimate.record_target(scene)
        guess = changed(scene, np.full(len(factors), 20.0))
        for sigma in NOISE:
            for seen in SEEN:
                capture = clothfit.degrade(truth, sigma, seen)
                began = time.perf_counter()
                fit = clothfit.estimate(guess, capture)
                seconds = time.perf_counter() - began
                report = clothfit.evaluate(scene, fit.scene)
                print(
                    f"| {scatter:.0%} | {metres(sigma)} | {seen:.0%} | {metres(report.fitted.rmse)} "
                    f"| {metres(report.horizon.rmse)} | {report.parameters[0].median_relative_deviation:.2g} "
                    f"| {seconds:.1f} |",
                    flush=True,
                )


def families() -> None:
    """`side` with another factor for each family of springs, from captures with noise of 1 mm: fitted with a factor for
    each family, and with a value for each spring.
    """
    print("| seed | fits | values | error to the true motion | over 500 frames | median deviation | rms | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    for seed in SEEDS:
        guess = scene_of("side", "nR")
        start = clothfit.parameters(guess)
        factors = np.exp(np.random.default_rng(seed).normal(0.0, WIDE, len(start)))
        truth = clothfit.with_parameters(guess, start * factors)
        capture = clothfit.degrade(clothfit.fit.estimate.record_target(truth), 1e-3, seed=seed)
        for settings in ("nR", "nL"):
            began = time.process_time()
            fit = clothfit.estimate(scene_of("side", settings), capture, options=clothfit.FitOptions(intervals=False))
            seconds = time.process_time() - began
            report = clothfit.evaluate(truth, fit.scene)
            away = np.log(fit.scene.cloths[0].stiffness / truth.cloths[0].stiffness)
            print(
                f"| {seed} | {settings} | {fit.parameters[0].count} | {metres(report.fitted.rmse)} "
                f"| {metres(report.horizon.rmse)} | {np.median(np.abs(away)):.2g} | {np.sqrt((away**2).mean()):.2g} "
                f"| {seconds:.1f} |",
                flush=True,
            )


def changed(scene: clothfit.Scene, stiffness: np.typing.NDArray[np.float64]) -> clothfit.Scene:
    """A scene of one cloth with other stiffnesses."""
    return scene.with_values([scene.cloths[0].mass], [stiffness])


TABLES: dict[str, Callable[[], None]] = {
    "experiments": experiments, "frames": frames, "noise": noise, "families": families,
}  # fmt: skip

if __name__ == "__main__":
    clothfit.estimate(
        scene_of("side", "nL", 10), options=clothfit.FitOptions(max_evaluations=2),
    )  # compiled from here on
    for table in sys.argv[1:] or TABLES:
        TABLES[table]()
        print()
