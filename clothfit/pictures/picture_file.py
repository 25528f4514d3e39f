"""Files of pictures: their kinds, whether they can be made and written, and the writing; and the colours of all
pictures: "#rrggbb" for what is drawn as it is, (red, green, blue) in 0 … 1 for what is shaded.

Lines have the colours of M. Okabe and K. Ito, which people with any kind of colour vision can tell apart. Pictures need
matplotlib or Pillow, which come with the extra `plot`; `check_picture` looks for them before long work.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, TypeAlias

from clothfit.base.errors import InvalidInput
from clothfit.base.writing import check_writable, write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Colour: TypeAlias = tuple[float, float, float]

BLUE, ORANGE, GREEN, PURPLE, RED, SKY = "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"

INK, QUIET = "#222222", "#767676"
"""Text, and text of less weight."""

GROUND, FIXED_VERTEX = "#f3f5f8", "#c22f2f"

CLOTHS = ((0.36, 0.51, 0.74), (0.83, 0.55, 0.36), (0.58, 0.45, 0.70), (0.75, 0.65, 0.33), (0.44, 0.47, 0.52))
"""Colours of the objects, in turn."""

TARGET_COLOUR, SPHERE_COLOUR = (0.10, 0.68, 0.33), (0.72, 0.72, 0.76)

NOT_IDENTIFIABLE = "#c4c8cf"
"""Parameters in a map that the motion does not determine."""

PLOTS, GIF = ("png", "svg", "pdf"), ("gif",)
DOTS_PER_INCH, FINER = 150, 300  # of a .png, and of the frames of a motion in a .svg or .pdf
FONTS = ["DejaVu Sans"]  # comes with matplotlib, so a picture does not depend on the fonts of the machine
STYLE = {"font.family": FONTS, "svg.hashsalt": "clothfit", "svg.fonttype": "path"}


def check_picture(path: str | os.PathLike[str], kinds: Sequence[str] = PLOTS) -> str:
    """The format that a path's extension names. Raises InvalidInput when no picture can be drawn or written there."""
    name = os.fspath(path)
    kind = os.path.splitext(name)[1].lower().removeprefix(".")
    if kind not in kinds:
        *others, last = (f".{one}" for one in kinds)
        ends = f"{', '.join(others)} or {last}" if others else last
        raise InvalidInput(f"{name}: a picture's name ends in {ends}")
    check_writable(path)
    library, module = ("Pillow", "PIL") if kind in GIF else ("matplotlib", "matplotlib")
    try:
        import_module(module)
    except ImportError:
        need = f"a picture needs {library}; install it with: pip install 'clothfit[plot]'"
        raise InvalidInput(f"{name}: {need}") from None
    return kind


def save(path: str | os.PathLike[str], draw: Callable[[], Figure]) -> None:
    """Write the figure that `draw` returns to a .png, .svg or .pdf, whole or not at all.

    The same figure gives the same file. Raises InvalidInput when it cannot be drawn or written.
    """
    kind = check_picture(path)
    from matplotlib import rc_context

    buffer = io.BytesIO()
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with rc_context(STYLE):  # type: ignore[arg-type]  # its stubs accept literal keys only
        draw().savefig(buffer, format=kind, dpi=DOTS_PER_INCH if kind == "png" else FINER, metadata=undated.get(kind))
    write_atomically(path, buffer.getvalue())
