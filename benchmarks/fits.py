"""Print what `clothfit estimate` makes of scenes: `python benchmarks/fits.py [SCENE …]`, by default the examples.

Each scene's own values are the truth and hidden from the fit. The error over 500 frames includes the fitted ones.
Seconds are those of the fit, compiled beforehand.
"""

from __future__ import annotations

import sys
from pathlib import Path

import clothfit
from clothfit.base.messages import metres

EXAMPLES = Path(__file__).parent.parent / "examples"


def row(path: Path) -> str:
    """One line of the table."""
    scene = clothfit.load(path)
    clothfit.estimate(scene, options=clothfit.FitOptions(max_evaluations=2))
    fit = clothfit.estimate(scene)
    report = clothfit.evaluate(scene, fit.scene)
    settings = " ".join(cloth.settings for cloth in scene.cloths)
    deviation = max(d.median_relative_deviation or 0.0 for d in report.parameters)
    return (
        f"| {path.stem} | {settings} | {len(clothfit.parameters(scene))} | {fit.status} | {metres(fit.rmse)} "
        f"| {metres(report.horizon.rmse)} | {deviation:.2g} | {fit.evaluations} | {fit.seconds:.1f} |"
    )


def main() -> None:
    """Print the table."""
    paths = [Path(argument) for argument in sys.argv[1:]] or sorted(EXAMPLES.glob("*.json"))
    print("| scene | fits | parameters | ends | RMSE | over 500 frames | median deviation | evaluations | seconds |")
    print("|---|---|---|---|---|---|---|---|---|")
    for path in paths:
        print(row(path), flush=True)


if __name__ == "__main__":
    main()
