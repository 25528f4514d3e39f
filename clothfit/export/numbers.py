"""JSON of tools, which has no infinite numbers."""

from __future__ import annotations

import json
from typing import Any

from clothfit.base.errors import InvalidInput


def text(document: Any, tool: str) -> str:
    """The JSON of a tool's file. Raises InvalidInput where what the tool takes in place of a value overflows."""
    try:
        return json.dumps(document, allow_nan=False)
    except ValueError:
        raise InvalidInput(
            f"{tool} cannot have the scene: a value in its terms is infinite; masses, stiffnesses or damping are "
            "beyond what a cloth has"
        ) from None
