"""Put a page together: one HTML file that needs nothing else, neither network nor other files.

The parts stand in `web/`: the page with places for the others, `{{name}}`, its style, and modules of JavaScript that
import one another by name. Each goes into an import map as a `data:` address, as modules cannot be loaded from
`file://`. What the page tells is a JSON document in a `script` element that no browser runs. A policy in the
page's head lets nothing load and no script of a name or a title run, whatever they say: names and titles are escaped,
and this is the second lock. (It allows `data:` beside the nonce, as not every browser passes that on to imports.)
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

WEB = Path(__file__).parent / "web"
THREE = "three/three.module.min.js"


def page(content: Mapping[str, Any]) -> bytes:
    """The page that shows a content."""
    told = script_text(content)
    modules = {path.stem: path.read_bytes() for path in sorted(WEB.glob("*.js"))}
    addresses = {"three": data_address((WEB / THREE).read_bytes())}
    addresses |= {f"clothfit/{name}": data_address(source, f"clothfit/{name}.js") for name, source in modules.items()}
    parts = {
        "title": html.escape(str(content["title"])),
        "nonce": hashlib.sha256(told.encode()).hexdigest()[:32],
        "style": (WEB / "page.css").read_text("utf-8"),
        "imports": json.dumps({"imports": addresses}),
        "content": told,
    }
    return filled((WEB / "page.html").read_text("utf-8"), parts).encode("utf-8", errors="replace")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """A template with its places filled, in one pass: what is filled in is not looked at again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def data_address(source: bytes, name: str = "") -> str:
    """A module as an address; `name` is what a browser's tools call it."""
    named = source + f"\n//# sourceURL={name}\n".encode() if name else source
    return f"data:text/javascript;base64,{base64.b64encode(named).decode()}"


def script_text(content: Mapping[str, Any]) -> str:
    """A content as JSON that ends no `script` element and begins no comment."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
