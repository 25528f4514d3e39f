"""The picture of a report in `docs/report.md`: `python docs/report_picture.py`. Needs Playwright, Pillow and Chromium.

It fits the shirt of the gallery, and shows the page in light colours and, to the right, in dark ones.
"""

from __future__ import annotations

import io
import os
import shutil
import tempfile
from pathlib import Path

from gallery import SHIRT, shoot
from PIL import Image

DOCS = Path(__file__).resolve().parent
SIZE = {"width": 1280, "height": 800}
FRAME, CUT = 30, 814  # the cut, in pixels, is between the columns
ARGUMENTS = ["--no-sandbox", "--disable-quic", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def shots(page_path: Path) -> list[Image.Image]:
    """The page in light and dark."""
    from playwright.sync_api import sync_playwright

    browser_path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=ARGUMENTS)
        page = browser.new_page(viewport=SIZE, reduced_motion="reduce", color_scheme="light")
        page.goto(page_path.as_uri())
        page.wait_for_selector("html[data-ready]", state="attached", timeout=120_000)
        page.evaluate(f"clothfit.player.goToFrame({FRAME})")
        found = []
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.wait_for_timeout(1500)
            found.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
        browser.close()
    return found


def main() -> None:
    """Write the picture."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(DOCS.parent / "examples", Path(folder) / "examples")
        os.chdir(folder)
        *before, fit = [command for command in SHIRT.commands if "guess.gif" not in command]
        shoot(SHIRT._replace(commands=(*before, fit.replace("--set gif=fit.gif", "--report report.html"))))
        light, dark = shots(Path(folder) / "report.html")
        os.chdir(DOCS)
    light.paste(dark.crop((CUT, 0, *dark.size)), (CUT, 0))
    light.save(DOCS / "report.png", optimize=True)


if __name__ == "__main__":
    main()
