"""What the options of `clothfit new` mean: texts to numbers, which of them go together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from typing import TYPE_CHECKING, NoReturn

import click

from clothfit.base.errors import InvalidInput
from clothfit.cli.common.options import is_number

if TYPE_CHECKING:
    from clothfit.meshes.mesh import Mesh

PLANE = "plane"
"""Stands for a mesh that needs no file."""

AIR, CALM, UNKNOWN = "air", 1.0, 5.0
"""Stands for the drag of real air; at so many m/s where there is no wind, and where it is to be found."""

Corner = tuple[float, ...]
"""Three coordinates, m."""

OF_PLANES = {"size": "--size", "divisions": "--divisions", "upright": "--upright"}
OF_MESHES = {"scale": "--scale", "up": "--up", "handedness": "--handedness", "weld": "--weld"}
PAIRS = (("delta", "--delta", "fps", "--fps"), ("bending", "--bending", "no_bending", "--no-bending"))
"""Options of which one says it all."""


@dataclass(frozen=True)
class Asked:
    """The options as they are given; None or empty where one is not."""

    size: str | None
    divisions: int | None
    upright: bool
    scale: float | None
    up: str | None
    handedness: str | None
    weld: str | None
    rotate: str | None
    move: str | None
    density: float
    stiffness: float
    bending: float | None
    no_bending: bool
    damping: float
    drag: str | None
    fix_box: tuple[str, ...]
    fix_vertices: str | None
    fix_side: tuple[str, ...]
    region: tuple[str, ...]
    warp: str | None
    sphere: tuple[str, ...]
    wind: str | None
    fit: tuple[str, ...]
    integrator: str
    delta: float | None
    fps: float | None
    frames: int
    tolerance: float
    title: str | None

    def check(self, is_plane: bool) -> None:
        """Raise UsageError where options do not go together, InvalidInput where a text is none of its option."""
        for field, name in (OF_MESHES if is_plane else OF_PLANES).items():
            if getattr(self, field) is not None and getattr(self, field) is not False:
                raise click.UsageError(f"{name} is for {'meshes from files' if is_plane else 'planes'}; leave it out")
        for field, name, other, other_name in PAIRS:
            if getattr(self, field) is not None and getattr(self, other):
                raise click.UsageError(f"{name} and {other_name} say the same; give one of them")
        if self.fps is not None and not 0 < self.fps < float("inf"):
            raise InvalidInput(f"--fps must be above 0 and finite; {self.fps:g} was given")

    @property
    def step(self) -> float:
        """The time step, s."""
        if self.fps is not None:
            return 1.0 / self.fps
        return 0.02 if self.delta is None else self.delta

    @property
    def blows(self) -> tuple[float, ...]:
        """The wind, m/s. Raises InvalidInput."""
        return numbers("--wind", self.wind or "0,0,0", 3, "5,0,1")

    def drag_of(self, mesh: Mesh) -> float:
        """The air drag of a mesh. Raises InvalidInput."""
        if not self.of_air:
            return numbers("--drag", self.drag or "0.1", 1, f"0.1 or {AIR}")[0]
        from clothfit.meshes.mesh import air_drag

        return air_drag(mesh, hypot(*self.blows) or (UNKNOWN if self._fits("wind") else CALM))

    @property
    def of_air(self) -> bool:
        """Whether the drag is that of real air: where it is asked for, or no number is and the wind is to be found."""
        return self.drag == AIR or (self.drag is None and self._fits("wind"))

    def _fits(self, kind: str) -> bool:
        return any(text.partition("=")[0] == kind for text in self.fit)

    @property
    def extent(self) -> tuple[float, float]:
        """Width and height of a plane, m. Raises InvalidInput."""
        sides = (self.size or "1").split("x")
        if len(sides) > 2 or "," in (self.size or "") or not all(is_number(side) for side in sides):
            refuse_text("--size", self.size or "", "2 or 2x1.5")
        width, *rest = numbers("--size", ",".join(sides), len(sides), "2 or 2x1.5")
        return width, rest[0] if rest else width

    @property
    def bends(self) -> bool | float:
        """Bending springs as `clothfit.mesh` takes them."""
        return not self.no_bending if self.bending is None else self.bending

    @property
    def boxes(self) -> list[tuple[Corner, Corner]]:
        """Two corners of each box, m. Raises InvalidInput."""
        return [box("--fix-box", text) for text in self.fix_box]

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """First and last of each range of vertices. Raises InvalidInput."""
        return [] if self.fix_vertices is None else ranges("--fix-vertices", self.fix_vertices)

    @property
    def sides(self) -> list[tuple[str, float | None]]:
        """Each side and how far it reaches, m. Raises InvalidInput."""
        return [side("--fix-side", text) for text in self.fix_side]

    @property
    def parts(self) -> list[tuple[str, str]]:
        """Name and place of each region. Raises InvalidInput."""
        split = [text.partition("=") for text in self.region]
        for text, (name, _, where) in zip(self.region, split, strict=True):
            if not name.strip() or not where:
                refuse_text("--region", text, "collar=top=0.05, collar=0-11,140 or collar=0,0,0:1,1,1")
        return [(name.strip(), where) for name, _, where in split]

    @property
    def along(self) -> tuple[float, ...] | None:
        """The direction of the warp."""
        return None if self.warp is None else tuple(float(axis == self.warp) for axis in "xyz")

    @property
    def distance(self) -> float | None:
        """Of welding, m; None for what counts as one place. Raises InvalidInput."""
        if self.weld in (None, ""):
            return None
        return numbers("--weld", str(self.weld), 1, "0.001")[0]

    @property
    def letters(self) -> str:
        """What to fit of masses and stiffnesses."""
        given = [text for text in self.fit if _lettered(text)]
        return given[-1] if given else "nn" if self.fit else "nF"

    @property
    def kinds(self) -> dict[str, str]:
        """What else to fit: modes by names. The drag of air depends on its speed: with the wind it is not known."""
        split = [text.partition("=") for text in self.fit if not _lettered(text)]
        given = {name: mode.upper() if equals else "G" for name, equals, mode in split}
        return {"drag": "G", **given} if self._fits("wind") and self.of_air else given


def understood(path: str | None, asked: Asked) -> tuple[str, Asked]:
    """What to make a scene of, and the options: what stands behind --weld is a distance only where it is a number.

    Raises MissingParameter.
    """
    if path is None and asked.weld and not is_number(asked.weld):
        return asked.weld, replace(asked, weld="")
    if path is None:
        raise click.MissingParameter(param_hint="'plane|MESH'", param_type="argument", ctx=click.get_current_context())
    return path, asked


def numbers(option: str, text: str, count: int, example: str) -> tuple[float, ...]:
    """So many numbers with commas between. Raises InvalidInput."""
    try:
        values = tuple(float(item) for item in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(abs(value) < float("inf") for value in values):
        refuse_text(option, text, example)
    return values


def box(option: str, text: str) -> tuple[Corner, Corner]:
    """Two corners of a box, m. Raises InvalidInput."""
    corners = text.split(":")
    if len(corners) != 2:
        refuse_text(option, text, "0,0,0:1,1,1")
    first, second = (numbers(option, corner, 3, "0,0,0:1,1,1") for corner in corners)
    return first, second


def ranges(option: str, text: str) -> list[tuple[int, int]]:
    """First and last of each range of vertices. Raises InvalidInput."""
    found = []
    for item in text.split(","):
        first, dash, last = item.strip().partition("-")
        ends = (first, last if dash else first)
        if not all(end.isascii() and end.isdigit() and len(end) < 19 for end in ends):
            refuse_text(option, text, "0,11,20-30")
        if int(ends[1]) < int(ends[0]):
            refuse_text(option, item.strip(), "0,11,20-30")
        found.append((int(ends[0]), int(ends[1])))
    return found


def side(option: str, text: str) -> tuple[str, float | None]:
    """A side and how far it reaches, m. Raises InvalidInput."""
    name, by, reach = text.partition("=")
    return name, numbers(option, reach, 1, "top=0.02")[0] if by else None


def refuse_text(option: str, text: str, example: str) -> NoReturn:
    """Raise InvalidInput for a text that is none of its option."""
    raise InvalidInput(f"{option}: {text!r} is not understood; give it as in {example}")


def _lettered(text: str) -> bool:
    return len(text) == 2
