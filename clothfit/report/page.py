"""A report: two scenes and perhaps a target motion → one HTML page that needs neither network nor other files.

The parts are in `web/`: the page with places `{{name}}` for the others, its style, and JavaScript modules that import
one another by name. Each module goes into an import map as a `data:` address, as modules cannot be loaded from
`file://`. The content of the page is a JSON document in a `script` element that no browser runs. Names and titles are
escaped; as a second safeguard, a content security policy lets nothing load and runs only scripts with the nonce. (It
allows `data:` as well, because not every browser passes the nonce on to imports.)
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from clothfit.objective.experiment import Recorded, motion_of
from clothfit.report.contents import content
from clothfit.report.log import Log
from clothfit.report.showing import BEFORE, shown
from clothfit.scene.scene import Scene

WEB = Path(__file__).parent / "web"
THREE = "three/three.module.min.js"


def report_page(
    truth: Scene,
    fitted: Scene,
    target: Recorded | None = None,
    *,
    frames: int | None = None,
    log: Log | None = None,
    others: Sequence[tuple[Scene, Log]] = (),
    commands: Sequence[str] = (),
    inputs: Sequence[tuple[str, str]] = (),
) -> bytes:
    """The page, HTML in UTF-8, that plays a fitted scene over the true one, or over a target, a motion or
    the path of its file, where one is given.

    `frames` counts the initial state (default: those of `evaluate`, fewer for large scenes). `log` is the course of the
    fit; with its `start` the page plays the motion before the fit as well. `others` are other fits of the same scene,
    with their logs, to stand beside this one. The page shows `commands`, which repeat the fit, and `inputs`, name and
    SHA-256 of each file. Raises InvalidInput when scenes or target do not fit, Diverged when the motion or its target
    has no second frame.
    """
    goal = None if target is None else motion_of(target, truth)
    show = shown(truth, fitted, goal, frames, others=beside(log, [scene for scene, _ in others]))
    logs = [other for _, other in others]
    return page(content(truth, fitted, show, log or Log(), None if goal is None else goal.name, logs), commands, inputs)


def beside(log: Log | None, others: Sequence[Scene]) -> list[tuple[str, Scene]]:
    """The motions to play beside the fitted one, with their names: that before the fit, where it is known, first."""
    before = [(BEFORE, log.start)] if log is not None and log.start is not None else []
    return [*before, *((scene.name, scene) for scene in others)]


def page(
    shows: Mapping[str, Any], commands: Sequence[str] = (), inputs: Sequence[tuple[str, str]] = ()
) -> bytes:
    """The page, HTML in UTF-8, that shows a content: of a fit, of a motion led through keys, or of one on a subspace.
    `commands` repeat it, `inputs` are name and SHA-256 of each file.
    """
    text = script_text({**shows, "commands": list(commands), "inputs": [list(pair) for pair in inputs]})
    parts = {
        "title": html.escape(str(shows["title"])),
        "nonce": hashlib.sha256(text.encode()).hexdigest()[:32],
        "style": (WEB / "page.css").read_text("utf-8"),
        "imports": import_map(sorted(WEB.glob("*.js"))),
        "content": text,
    }
    return filled((WEB / "page.html").read_text("utf-8"), parts).encode("utf-8", errors="replace")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """A template with its places filled in one pass, so that places in the inserted text stay as they are."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def import_map(paths: Iterable[Path], named: bool = True) -> str:
    """The import map of modules and of three.js, each as a `data:` address; `named` for a browser's developer tools."""
    sources = {"three": (WEB / THREE).read_bytes()}
    for path in paths:
        name = f"clothfit/{path.stem}"
        sources[name] = path.read_bytes() + (f"\n//# sourceURL={name}.js\n".encode() if named else b"")
    coded = {name: base64.b64encode(source).decode() for name, source in sources.items()}
    return json.dumps({"imports": {name: f"data:text/javascript;base64,{text}" for name, text in coded.items()}})


def script_text(shows: Mapping[str, Any]) -> str:
    """A content as JSON that cannot end a `script` element or begin a comment."""
    text = json.dumps(shows, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
