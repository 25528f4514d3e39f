"""Draw the picture of the README: a cloth before and after the fit, over its target (`python docs/picture.py`).

The scene is examples/corners.json: 12 × 12 vertices, fixed at the corners. Upper row: a first guess, the same mass for
every vertex. Lower row: one mass per vertex, fitted from there. Green: the target. The file is plain SVG.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import clothfit

HERE = Path(__file__).parent
SIDE = 12  # vertices along each side of the example's cloth
GUESS = 0.1  # kg
FRAMES = (15, 30, 60, 99)
PANEL, SCALE = (250.0, 196.0), 22.0  # pixels, pixels per metre
STYLE = """
.t{fill:none;stroke:#2a9d5c;stroke-width:3.2;stroke-opacity:.55;stroke-linejoin:round}
.f{fill:none;stroke:#1d3557;stroke-width:.8;stroke-linejoin:round}
text{font:13px sans-serif;fill:#444}
"""


def project(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels (n, 2) of positions (n, 3) m, seen from above at an angle."""
    turn, tilt = np.radians(35), np.radians(28)
    right = np.cos(turn) * x[:, 0] + np.sin(turn) * x[:, 2]
    away = -np.sin(turn) * x[:, 0] + np.cos(turn) * x[:, 2]
    return SCALE * np.stack([right, -np.cos(tilt) * x[:, 1] + np.sin(tilt) * away], axis=1)


def mesh(x: NDArray[np.float64], kind: str, origin: tuple[float, float]) -> str:
    """The rows and columns of the cloth as polylines."""
    grid = (project(x) + origin).reshape(SIDE, SIDE, 2)
    lines = [*grid, *grid.transpose(1, 0, 2)]
    return "".join(
        f'<polyline class="{kind}" points="{" ".join(f"{u:.1f},{v:.1f}" for u, v in line)}"/>' for line in lines
    )


def draw() -> str:
    """The whole picture."""
    scene = clothfit.load(HERE.parent / "examples" / "corners.json")
    target = clothfit.simulate(scene, tolerance=1e-10)
    guess = clothfit.with_parameters(scene, np.full(len(clothfit.parameters(scene)), GUESS))
    fit = clothfit.estimate(scene, start=GUESS)
    rows = [(f"a first guess, {GUESS} kg a vertex", guess), (f"fitted, {fit.evaluations} evaluations", fit.scene)]
    parts = []
    for row, (title, fitted) in enumerate(rows):
        motion = clothfit.simulate(fitted, tolerance=1e-10)
        rmse = np.sqrt(((motion.positions - target.positions) ** 2).sum(axis=2).mean())
        top = row * (PANEL[1] + 26)
        error = f"{1e3 * rmse:.0f} mm" if rmse > 1e-3 else f"{1e9 * rmse:.0f} nm"
        parts.append(f'<text x="8" y="{top + 18:.0f}">{title}: RMSE {error}</text>')
        for column, frame in enumerate(FRAMES):
            origin = ((column + 0.5) * PANEL[0], top + 78)
            parts.append(mesh(target.positions[frame], "t", origin) + mesh(motion.positions[frame], "f", origin))
            if row == 1:
                time = f"t = {target.times[frame]:.1f} s"
                parts.append(f'<text x="{origin[0] - 22:.0f}" y="{top + PANEL[1] + 18:.0f}">{time}</text>')
    width, height = PANEL[0] * len(FRAMES), 2 * (PANEL[1] + 26)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}">'
    return f'{head}<style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>{"".join(parts)}</svg>\n'


if __name__ == "__main__":
    (HERE / "fit.svg").write_text(draw(), encoding="utf-8")
