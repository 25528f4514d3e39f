"""A process that does one task, so that what is played meanwhile does not wait: started by `task`, which it talks with
in pickles over its standard input and output.

It gets one task, then perhaps the word "cancel", which ends a fit as Ctrl-C would: with the best so far. When its
input ends, so does it.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
from collections.abc import Callable
from typing import Any

from clothfit.base import interrupts
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live.tasks.opening import load
from clothfit.live.tasks.searches import control, estimate, record

TASKS: dict[str, Callable[..., None]] = {"record": record, "estimate": estimate, "control": control, "load": load}


def listen(source: Any) -> None:
    """Hear what else is asked for, in a thread."""
    while True:
        try:
            word = pickle.load(source)
        except (EOFError, OSError, pickle.UnpicklingError):
            os._exit(0)  # whoever asked is gone
        if word == "cancel":
            interrupts.request()


def main() -> None:
    """Do one task."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what others print is no message
    lock = threading.Lock()

    def tell(kind: str, **content: Any) -> None:
        with lock:
            pickle.dump((kind, content), out)
            out.flush()

    name, arguments = pickle.load(sys.stdin.buffer)
    threading.Thread(target=listen, args=[sys.stdin.buffer], daemon=True).start()
    try:
        with interrupts.deferred():
            TASKS[name](tell, **arguments)
    except ClothfitError as error:
        tell("failed", reason=str(error), code=error.exit_code, invalid=isinstance(error, InvalidInput))
    except KeyboardInterrupt:
        tell("cancelled")
    except MemoryError:
        tell("failed", reason=f"{name}: there is not enough memory", code=1, invalid=False)


if __name__ == "__main__":
    main()
