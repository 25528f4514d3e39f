"""`clothfit subspace build`: a model of recorded motions, by physics or by a network, and what is said of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import metres
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import length, refuse
from clothfit.cli.common.output import Output, print_json
from clothfit.many.job import INTERRUPTED

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene
    from clothfit.subspace.build import Options, Report
    from clothfit.subspace.model import Model
    from clothfit.subspace.network.learn import Schooling
    from clothfit.subspace.network.training import Progress
    from clothfit.subspace.recording import Data

POOR = 0.1
"""Error of a motion, relative to its RMS, from which on there is a warning."""

LINES = 6
"""Looks at a training for one line that is printed."""


def options_of(given: dict[str, Any]) -> Options:
    """The options of a build."""
    from clothfit.subspace.build import CUBATURES, Options

    asked = given["cubature"]
    cubature = CUBATURES if asked is None else (asked,) if asked else ()
    if given["method"] == "network":
        cubature = ()
    size, error, seed = given["basis"], length(given["error"], "--error"), given["seed"] or 0
    return Options(size, error, cubature, given["modes"], bool(given["normals"]), bool(given["half"]), seed)


def school_of(given: dict[str, Any], out: Output) -> Schooling | None:
    """How to train; None for physics. Raises InvalidInput."""
    if given["method"] != "network":
        training = ("minutes", "rounds", "resume")
        refuse({f"--{name}": given[name] for name in training}, "{} goes with --method network")
        return None
    refuse({"--cubature": given["cubature"]}, "{} does not go with --method network")
    if given["minutes"] is not None and given["rounds"] is not None:
        raise click.UsageError("--minutes and --rounds: give one of them", click.get_current_context())
    from clothfit.subspace.network.learn import Schooling
    from clothfit.subspace.network.training import MINUTES, Budget

    if given["resume"] and out.is_stream:
        raise InvalidInput("--resume needs a file -o; - was given")
    budget = Budget(MINUTES if given["minutes"] is None else given["minutes"], given["rounds"])
    budget.check()
    return Schooling(budget, given["seed"] or 0, state_of(out) if given["resume"] else None)


def state_of(out: Output) -> str:
    """The file of a training's state."""
    return str(Path(out.path).with_suffix("")) + ".training.npz"


def built(
    data: Data, options: Options, school: Schooling | None, out: Output, about: dict[str, Any], console: Console,
) -> int | None:  # fmt: skip
    """Build a model, write it, and say how good it is."""
    from clothfit.base import threads
    from clothfit.subspace.build import build as build_model
    from clothfit.subspace.build import summary
    from clothfit.subspace.model import encoded

    console.announce_compilation()
    with threads.single(), interrupts.deferred():
        model, found = build_model(data, options, console.detail)
        ended = True
        if school:
            model, ended = trained(model, found, data, school, out, console)
        out.write(encoded(model))
    for c, each in enumerate(found):
        show(f"objects[{c}]", each, console)
        show_worth(data.scene, c, each, model.method, console)
    console.say(f"→ {out.name}")
    more = {"training": model.built["training"]} if school else {}
    objects = [summary(each) for each in found]
    print_json({"recorded": about, "objects": objects, **more, "output": out.path})
    return None if ended else INTERRUPTED


def trained(
    model: Model, found: list[Report], data: Data, school: Schooling, out: Output, console: Console
) -> tuple[Model, bool]:
    """The model with networks, and whether their training came to its end; its state is kept beside."""
    from clothfit.subspace.network.learn import identity, keep, pupils, teach

    own = pupils(model, data, school)
    interrupts.hold()  # from now on there is a network to keep
    states = [each.training.state for each in own]
    if all(school.budget.done(len(own) * state.seconds, state.rounds) >= 1.0 for state in states):
        rounds = max(state.rounds for state in states)
        minutes = sum(state.seconds for state in states) / 60.0
        console.warn(f"the training has had {minutes:.2g} minutes and {rounds} rounds already; ask for more --rounds")

    def say(c: int, progress: Progress) -> None:
        text = f"objects[{c}]: {100 * progress.done:.0f} % of the training, {progress.rounds} rounds: "
        text += f"{100 * progress.error:.2g} % on motions held out, {100 * progress.best:.2g} % at best"
        looks = own[c].training.state.curve
        (console.say if len(looks) % LINES == 0 or progress.done >= 1.0 else console.detail)(text)

    made, ended = teach(model, found, data, own, school, say)
    if not out.is_stream:
        keep(state_of(out), own, identity(model, data, school))
        if not ended:
            console.warn(f"interrupted: the best network so far is kept; go on with --resume ({state_of(out)})")
    return made, ended


def show_worth(scene: Scene, c: int, found: Report, method: str, console: Console) -> None:
    """Say from how many vertices on such a model is faster than full steps."""
    from clothfit.subspace.judge import whole
    from clothfit.subspace.worth import pays_from

    count = pays_from(scene, c, found.vectors, method, whole(found.us_per_frame), found.full_us_per_step)
    if found.pays:
        console.result(f"such a model pays from about {count} vertices on; here there are {len(scene.cloths[c].mass)}")
    else:
        console.warn(f"objects[{c}]: a subspace does not pay for so few vertices, but from about {count} on; full "
                     "steps are faster")  # fmt: skip


def show(name: str, found: Report, console: Console) -> None:
    """Say what a model of one object leaves out, evaluates and misses."""
    from clothfit.subspace.judge import whole

    console.result(f"{name}: {found.vectors} vectors")
    console.table([("vectors", "leave out"), *((str(k), metres(v)) for k, v in found.left_out.items())])
    used = ", ".join(f"{a} of {b} {kind}" for kind, (a, b) in found.elements.items() if b)
    network = not any(a for a, _ in found.elements.values())
    if not network:
        console.result(f"evaluated: {used}")
    frame, step = whole(found.us_per_frame), found.full_us_per_step
    console.result(f"a frame takes {frame:.0f} µs, with positions and normals; a full step takes {step:.0f} µs")
    second = "by the network" if network else "as evaluated"
    for what, own in (("with all elements", found.whole), (second, found.sampled)):
        if own is not None:
            console.result(f"a motion beside those, {what}: {metres(own.rmse)}, {100 * own.relative:.2g} % of its RMS")
    if found.sampled is not None and found.sampled.relative > POOR:
        console.warn(f"{name}: the subspace does not follow that motion; try more vectors (--basis), more motions "
                     "(--episodes), or weaker inputs (--wind, --pace)")  # fmt: skip
    if found.floor:
        from clothfit.subspace.judge import at_best

        console.result(at_best(found.floor))
