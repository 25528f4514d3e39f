"""`clothfit fabrics`: what real cloth is like."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from clothfit.cli.common.console import Console
from clothfit.cli.common.options import standard_command
from clothfit.cli.common.output import print_json

if TYPE_CHECKING:
    from clothfit.fabric.presets import Preset, Values

UNITS = {"density": (1e3, "g/m²"), "stretch": (1.0, "N/m"), "bending": (1e6, "µN m")}


@standard_command("fabrics")
@click.argument("names", metavar="[NAME]...", nargs=-1)
def command(names: tuple[str, ...], console: Console) -> None:
    """List real fabrics, for clothfit new --fabric: weight, and where they are known stretch and bending along warp,
    weft and bias. With names also where each number is from, and the range of what was measured.

    \b
    clothfit fabrics
    clothfit fabrics denim trousers
    clothfit new plane --fabric denim
    """
    from clothfit.fabric.presets import preset, presets

    chosen = [preset(name) for name in names] if names else presets()
    head = ["", *(f"{name}, {unit}" for name, (_, unit) in UNITS.items()), "what it is"]
    console.table([head, *([each.name, *map(text, cells(each)), each.description] for each in chosen)])
    sources = dict[str, list[str]]()
    for each in chosen if names else ():
        for what, source in each.source.items():
            factor, unit = UNITS[what]
            ends = each.ranges.get(what)
            between = f" ({factor * ends[0]:.3g} to {factor * ends[1]:.3g} {unit})" if ends else ""
            sources.setdefault(source, []).append(f"{each.name} {what}{between}")
    for source, numbers in sources.items():
        console.result(f"{'; '.join(numbers)}: {source}")
    print_json({"fabrics": [asdict(each) for each in chosen]})


def cells(own: Preset) -> list[Values]:
    """The numbers of a row, in the units of its head."""
    values: list[Values] = [(own.density, None, None), own.stretch, own.bending]
    return [
        tuple(None if value is None else factor * value for value in each)  # type: ignore[misc]
        for each, (factor, _) in zip(values, UNITS.values(), strict=True)
    ]


def text(values: Values) -> str:
    """Numbers with strokes between, and nothing where none is known."""
    return " / ".join(f"{value:.3g}" for value in values if value is not None)
