"""How large a report is and how fast it plays: `python benchmarks/report.py [SIDE] [FRAMES]`, default 71 (5,041
vertices) and 300. Needs Playwright and Chromium.

A waving cloth of SIDE × SIDE vertices, fitted and target 1 % apart, no simulation. Told are the size of the page, the
time until it is ready, that of JavaScript per frame (both cloths moved, with their normals, and coloured), and the
frames that are drawn per second; without a graphics card a processor draws them, which says little of other machines.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import clothfit
from clothfit.meshes.mesh import object_document, plane
from clothfit.motion.motion import as_motion
from clothfit.report.page import report_page

ARGUMENTS = [
    "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-quic", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip
MODES = ("plain", "error", "mass", "strain")
LOOPS = 200

MEASURE = """([loops]) => {
  const { player, fitted } = clothfit;
  player.pause();
  const began = performance.now();
  for (let i = 0; i < loops; i++) player.goTo(player.times[i % (player.times.length - 1)] + 0.005);
  return (performance.now() - began) / loops;
}"""

DRAWN = """() => new Promise((done) => {
  const { stage, player } = clothfit;
  const draw = stage.render.bind(stage);
  let count = 0;
  stage.render = () => { count++; draw(); };
  player.play();
  setTimeout(() => { count = 0; }, 3000);  // so long it may take to find what the machine can do
  setTimeout(() => { stage.render = draw; player.pause(); done(count / 4); }, 7000);
})"""


def waving(side: int, frames: int, amplitude: float) -> np.ndarray:
    """Positions (frames, side², 3) of a cloth in a breeze."""
    x = plane(side - 2, 2.0).positions
    t = 0.02 * np.arange(frames)[:, None]
    high = amplitude * (np.sin(5 * t - 6 * x[:, 0]) + 0.5 * np.sin(7 * t + 4 * x[:, 2] - 9 * x[:, 0] * x[:, 2]))
    sway = 0.2 * amplitude * np.sin(3 * t + 5 * x[:, 2])
    return np.stack([x[:, 0] + sway, high, np.broadcast_to(x[:, 2], high.shape)], axis=2)


def page_of(side: int, frames: int) -> bytes:
    """The page of such a cloth."""
    mesh = plane(side - 2, 2.0)
    made = object_document(mesh, np.zeros(side**2, bool), density=0.2, stiffness=50.0, damping=0.1, settings="nG")
    scene = clothfit.load({
        "title": "waving", "integrationMethod": 2, "delta": 0.02, "tolerance": 1e-5, "optimizationIterations": frames,
        "forwardSubSteps": 1, "printTimes": False, "windVel": {"x": 0, "y": 0, "z": 0}, "objects": [made],
        "colliders": [],
    })  # fmt: skip
    own, goal = (as_motion(scene, waving(side, frames, amplitude)) for amplitude in (0.202, 0.2))
    from clothfit.report import showing

    showing.finite_part = lambda *_: (own, None)  # the waving is what the simulation would give
    return report_page(scene, scene, goal)


def measure(path: Path) -> None:
    """Print how a page plays."""
    from playwright.sync_api import sync_playwright

    browser_path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
        began = time.perf_counter()
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-ready]", state="attached")
        print(f"ready after {time.perf_counter() - began:.2f} s")
        for mode in MODES:
            page.evaluate("(mode) => document.querySelector(`#modes [value=${mode}]`).click()", mode)
            print(f"{mode:8} JavaScript {page.evaluate(MEASURE, [LOOPS]):.2f} ms per frame, "
                  f"{page.evaluate(DRAWN):.0f} frames drawn per second")
        browser.close()


def main() -> None:
    """Make the page and measure it."""
    side, frames = (int(text) for text in (*sys.argv[1:], *("71", "300")[len(sys.argv) - 1 :]))
    began = time.perf_counter()
    made = page_of(side, frames)
    print(f"{side**2} vertices, {frames} frames: {len(made) / 1e6:.1f} MB, made in {time.perf_counter() - began:.1f} s")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        path.write_bytes(made)
        measure(path)


if __name__ == "__main__":
    main()
