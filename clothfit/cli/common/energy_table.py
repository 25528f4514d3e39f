"""What `clothfit simulate --energy` tells, keeps and hands to scripts: where the energy of a motion is and went."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from clothfit.cli.common.console import Console

if TYPE_CHECKING:
    from clothfit.base.arrays import Array
    from clothfit.motion.energy import Energy

STORED = ("kinetic", "elastic", "gravity", "contact", "total")
FLOWS = ("wind", "damping", "drag", "numerical")
OPTIONAL = ("contact", "wind", "damping", "drag")  # columns of which nothing is said where they are 0 throughout
ROWS = 10  # of the table, besides the start
ROUNDING = 1e-12
"""Of the most energy that is ever in one place, what counts as nothing."""


def columns(energy: Energy) -> dict[str, Array]:
    """All that is known of each frame, (frames,) J each."""
    own = {name: values for name, values in asdict(energy).items() if name != "times"}
    return {**own, "total": energy.total, "dissipated": energy.dissipated, "numerical": energy.numerical}


def arrays(energy: Energy | None) -> dict[str, Array]:
    """What a motion file keeps of it."""
    return {} if energy is None else {f"energy_{name}": values for name, values in columns(energy).items()}


def show(energy: Energy | None, console: Console) -> None:
    """Print some of the frames, and what the integrator did."""
    if energy is None:
        return
    told, least = columns(energy), ROUNDING * energy.scale
    names = [name for name in (*STORED, *FLOWS) if name not in OPTIONAL or abs(told[name]).max() > least]
    last = len(energy.times) - 1
    frames = sorted({round(last * i / ROWS) for i in range(ROWS + 1)})
    console.say("energy, J: stored at a frame; given by the wind and taken, until then, by damping, air and integrator")
    rows = [(str(k), f"{energy.times[k]:.4g} s", *(number(told[name][k], least) for name in names)) for k in frames]
    console.table([("frame", "time", *names), *rows])
    rise, frame = energy.largest_rise
    if rise > least:
        share = f"{100 * rise / energy.scale:.2g} % of the most that is ever in one place"
        console.say(f"the total rises by up to {rise:.3g} J over a step (frame {frame}), not from the wind: {share}")
    else:
        console.say("the total never rises over a step beyond what the wind gives it")


def number(value: float, least: float) -> str:
    """A cell of the table; what is only rounding is 0."""
    return "0" if abs(value) <= least else f"{value:.4g}"


def summary(energy: Energy | None) -> dict[str, Any]:
    """What --json prints of it."""
    if energy is None:
        return {}
    told, (rise, frame) = columns(energy), energy.largest_rise
    ends = {end: {name: float(told[name][k]) for name in STORED} for end, k in (("start", 0), ("end", -1))}
    flows = {name: float(told[name][-1]) for name in (*FLOWS, "dissipated")}
    return {
        "energy": {**ends, **flows, "largest_rise": rise, "largest_rise_frame": frame, "scale": energy.scale},
    }
