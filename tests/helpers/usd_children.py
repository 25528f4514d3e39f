"""Reads USD files, each in a process of its own, and prints how those ended: 0 read, 3 refused, below 0 killed.

`python usd_children.py FILE…`. The library is loaded once, and writes reports of its crashes to the folder TMPDIR.
"""

import json
import os
import signal
import sys

from pxr import Usd, UsdGeom  # noqa: F401  so that the processes have it

from clothfit.formats import usd_reader


def ended(path: str) -> int:
    """How reading one file ends."""
    number = os.fork()
    if number == 0:
        signal.alarm(60)
        code = 3
        try:
            usd_reader.limit_memory(usd_reader.OPENING_BYTES)
            usd_reader.parsed(path, "a")
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


if __name__ == "__main__":
    print(json.dumps([ended(path) for path in sys.argv[1:]]))
