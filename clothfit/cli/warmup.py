"""`clothfit warmup`: compile everything ahead of time."""

from __future__ import annotations

import os
import time

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import option, standard_command
from clothfit.cli.common.output import print_json


@standard_command("warmup")
@option("--small", "Leave out what only cloths of 3000 free vertices and more need.")
def command(small: bool, console: Console) -> None:
    """Compile everything for this machine ahead, so that no command has to wait for it.

    The compiled code is stored in NUMBA_CACHE_DIR if that is set, else with the package or, if that is not writable, in
    the user's cache. Run this when you build an image, with the same NUMBA_CACHE_DIR and the right to write there.

    \b
    clothfit warmup
    NUMBA_CACHE_DIR=/var/cache/clothfit clothfit warmup --json
    """
    from clothfit.kernels.cache import KernelCache
    from clothfit.many.warmup import Part, warm_up

    def show(part: Part) -> None:
        if part.compiled:
            what = counted(part.compiled, "function", "functions")
            console.say(f"{part.name}: {what} compiled in {part.seconds:.1f} s")

    began = time.perf_counter()
    console.announce_compilation("compiling for this machine: about a minute …")
    parts = warm_up(show, small)
    seconds, compiled = time.perf_counter() - began, sum(part.compiled for part in parts)
    if KernelCache.failed:
        raise InvalidInput("the compiled code could not be stored; set NUMBA_CACHE_DIR to a folder that can be written")
    folder = os.fspath(KernelCache.used or "")
    what = f"{compiled} functions compiled in {seconds:.1f} s, kept" if compiled else "everything is compiled, kept"
    console.say(f"{what} in {folder}")
    own = [part._asdict() for part in parts]
    print_json({"compiled": compiled, "seconds": seconds, "folder": folder, "parts": own})
