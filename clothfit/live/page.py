"""The live page: the modules of a report's page, with a main of its own."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

from clothfit.report.page import THREE, WEB, data_address, filled

OWN = Path(__file__).parent / "web"


@lru_cache(maxsize=1)
def parts() -> dict[str, str]:
    """The page's parts, read once."""
    paths = {path.stem: path for folder in (WEB, OWN) for path in sorted(folder.glob("*.js"))}
    addresses = {"three": data_address((WEB / THREE).read_bytes())}
    addresses |= {
        f"clothfit/{name}": data_address(path.read_bytes(), f"clothfit/{name}.js") for name, path in paths.items()
    }
    styles = [(WEB / "page.css").read_text("utf-8"), (OWN / "live.css").read_text("utf-8")]
    return {
        "style": "\n".join(styles),
        "imports": json.dumps({"imports": addresses}),
        "page": (OWN / "live.html").read_text("utf-8"),
    }


def live_page(nonce: str) -> bytes:
    """The page, HTML in UTF-8, whose scripts have a nonce."""
    own = parts()
    return filled(own["page"], {"style": own["style"], "imports": own["imports"], "nonce": nonce}).encode("utf-8")
