"""What `--json` prints: one object, in the same form for all commands."""

from __future__ import annotations

import json
import math
import sys
from typing import Any

from clothfit.cli.common.output import Output

SCHEMA_VERSION = 1


def document(command: str, summary: dict[str, Any]) -> dict[str, Any]:
    """The object that --json prints."""
    return {"schema_version": SCHEMA_VERSION, "command": command, **summary}


def print_json(command: str, summary: dict[str, Any], out: Output | None = None) -> None:
    """Print a summary as JSON on standard output, or on standard error when the result itself goes there."""
    text = json.dumps(plain(document(command, summary)), allow_nan=False)
    print(text, file=sys.stderr if out is not None and out.is_stream else sys.stdout, flush=True)


def plain(value: Any) -> Any:
    """The value with what JSON cannot hold, numbers that are not finite, replaced by None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
