"""`clothfit serve`: a page on this machine that plays, tunes and fits a scene."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import webbrowser
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from clothfit.base import memory
from clothfit.base.errors import InvalidInput
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import check_there, one_stream, read_scene, warn_of_steps
from clothfit.cli.common.options import option, section, standard_command
from clothfit.cli.common.output import print_json

if TYPE_CHECKING:
    from clothfit.formats.axes import Reading
    from clothfit.live.server import Server


@standard_command("serve")
@click.argument("scene_path", metavar="SCENE")
@section("What to serve")
@option("--target MOTION", "Show this motion as a ghost, and fit to it.  [default: the scene's own motion]",
        name="target_path")
@option("--port P", "Port on this machine.  [default: a free one]", click.IntRange(0, 65535), default=0)
@option("--open", "Open the page in a browser.", name="opens")
@section("The file of the target")
@motions.reads
def command(
    scene_path: str, target_path: str | None, reading: Reading, port: int, opens: bool, console: Console,
) -> None:
    """Serve a page on this machine that plays SCENE, with sliders, a hand and a fit.

    Prints the address, which has a token: only who knows it can steer. Programs ask for positions at the same address;
    docs/serve.md says how. Needs tornado: pip install 'clothfit[serve]'. Ctrl-C ends it.

    \b
    clothfit serve scene.json --open
    clothfit serve scene.json --target capture.npz --port 8000
    """
    one_stream(scene_path, target_path)
    check_there(scene_path, *filter(None, [target_path]))
    try:
        import tornado  # noqa: F401
    except ImportError:
        raise InvalidInput("serve needs tornado; install it with: pip install 'clothfit[serve]'") from None
    from clothfit.live.server import Server

    scene = read_scene(scene_path, console)
    warn_of_steps(scene, scene.frames, console)
    target = motions.read_motion(target_path, scene, reading, console) if target_path else None

    def ready(server: Server) -> None:
        console.say("open this address in a browser; Ctrl-C ends")
        if not print_json({"scene": scene.name, "address": server.address, "port": server.port}):
            click.echo(server.address)
        if opens and not webbrowser.open(server.address):
            console.warn("there is no browser to open; open the address yourself")

    memory.tidy()  # it may run for days
    server = Server(scene, target, port)
    asyncio.run(served(server, ready))
    console.say(f"{scene.name}: the server has ended")
    if server.session.engine.lives:  # it compiles, for which nobody who ends the server wants to wait
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


async def served(server: Server, ready: Callable[[Server], None]) -> None:
    """Serve until a signal asks to end."""
    ended, loop = asyncio.Event(), asyncio.get_running_loop()
    for kind in (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])):
        try:
            loop.add_signal_handler(kind, ended.set)
        except NotImplementedError:  # Windows, where Ctrl-C interrupts the loop
            break
    await server.start()
    try:
        ready(server)
        await ended.wait()
    finally:
        await server.close()
