"""A real browser for tests of pages: Chromium without a window, through Playwright, with the network off."""

import io
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = [
    "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-quic", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip
"""Root may start it, nothing of it asks the network, and a processor draws where there is no graphics card."""

SIZE = {"width": 620, "height": 440}
PATIENCE = 60_000  # ms until a page is ready, on a machine that has other things to do


@contextmanager
def browser() -> Iterator[Any]:
    """A browser; the test is skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip(f"there is no {', '.join(NAMES)} in PATH")
    with playwright.sync_playwright() as started:
        yield started.chromium.launch(executable_path=path, args=ARGUMENTS)


@contextmanager
def opened(started: Any, path: Path, size: dict[str, int] = SIZE) -> Iterator[tuple[Any, list[str]]]:
    """A page from disk that is ready and stands still, and the list of all that it says on the console."""
    context = started.new_context(viewport=size, offline=True, reduced_motion="reduce")
    page = context.new_page()
    said: list[str] = []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on("requestfailed", lambda request: said.append(f"request: {request.url[:80]}"))
    page.goto(path.as_uri())
    page.wait_for_selector("html[data-ready]", state="attached", timeout=PATIENCE)
    yield page, said
    context.close()


def pixels(page: Any) -> np.ndarray:
    """What the page's canvas and its frame show, (height, width, 3), after what was asked for is drawn."""
    from PIL import Image

    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    shot = page.locator("#stage").screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), dtype=np.int16)


def accessibility_script() -> str:
    """The text of axe-core, which finds what people with some disability cannot use; the test is skipped where it is
    not installed: AXE_CORE names its file, or npm has it in the folder `node_modules` of this one or one above.
    """
    places = [folder / "node_modules" / "axe-core" / "axe.min.js" for folder in (Path.cwd(), *Path.cwd().parents)]
    given = os.environ.get("AXE_CORE")
    found = next((path for path in ([Path(given)] if given else places) if path.is_file()), None)
    if found is None:
        pytest.skip("axe-core is not installed (npm install axe-core, or AXE_CORE=FILE)")
    return found.read_text("utf-8")


def differing(a: np.ndarray, b: np.ndarray) -> int:
    """How many pixels of two pictures differ clearly."""
    return int((np.abs(a - b).max(axis=2) > 24).sum())
