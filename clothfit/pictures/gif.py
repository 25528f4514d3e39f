"""A motion as a looping GIF in real time, written with Pillow.

Each frame is drawn (`stage`) at twice its size and then reduced, which smooths the edges. A GIF counts time in
hundredths of a second, and viewers show a frame for at least two of them, so frames are left out: those shown lie
`SHORTEST_INTERVAL` apart, or farther where there would be too many. A motion too short to watch is slowed down, and the
picture says so. All frames share one palette.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.pictures import stage as scenery
from clothfit.pictures.picture_file import CLOTHS, FIXED_VERTEX, GROUND, TARGET_COLOUR, Colour
from clothfit.pictures.stage import ARROW, LEGEND, Marks, Stage, in_pixels

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

    from clothfit.scene.scene import Scene

GIF_WIDTH, OVERSAMPLING = 640, 2
"""Width of a frame in pixels, and how many times finer it is painted."""

GIF_FACES = 20_000
"""Most faces in a frame; larger meshes are thinned."""

SHORTEST_INTERVAL, MOST_GIF_FRAMES = 0.04, 150
"""Least seconds between frames, and most frames."""

SLOWED_BELOW, SLOWED_TO = 0.5, 2.0
"""Seconds: a motion shorter than the first is slowed down to last the second."""

LAST_FRAME_PAUSE = 0.6
"""Seconds for which the last frame is shown, and that of a key."""

PALETTE_SIZE = 112
GIF_ASPECT = (0.45, 1.0)  # height by width, at least and at most
GIF_INK, GIF_QUIET = "#464a52", "#969aa2"
LEGEND_NAMES = (("target", TARGET_COLOUR), ("fitted", CLOTHS[0]))
SEEN_TARGET = "#169648"  # vertices of a target that is seen in part


class Film(NamedTuple):
    """The frames that are shown, and for how long."""

    frames: list[int]
    durations: list[int]  # ms, multiples of 10
    speed: float  # 1: real time


def film(times: Array, held: Iterable[int] = ()) -> Film:
    """Choose frames to show from those at `times` (F,), s, among them those that are `held` for longer."""
    wanted = {int(frame) for frame in held}
    length = float(times[-1] - times[0])
    speed = 1.0 if length >= SLOWED_BELOW or length == 0 else length / SLOWED_TO
    shown = (times - times[0]) / speed
    interval = max(SHORTEST_INTERVAL, float(shown[-1]) / MOST_GIF_FRAMES)
    frames = [0]
    for frame in range(1, len(times)):
        if frame in wanted or shown[frame] - shown[frames[-1]] >= 0.999 * interval:
            frames.append(frame)
    ends = [*shown[frames[1:]], shown[frames[-1]]]
    waits = np.diff(np.round(100 * np.array([0.0, *ends])).astype(int))
    longer = [LAST_FRAME_PAUSE if frame in wanted or frame == frames[-1] else 0.0 for frame in frames]
    durations = [10 * max(2, int(wait) + round(100 * pause)) for wait, pause in zip(waits, longer, strict=True)]
    return Film(frames, durations, speed)


def animation(
    scene: Scene,
    times: Array,
    x: Array,
    over: Array | None = None,
    width: int = GIF_WIDTH,
    marks: Marks | None = None,
) -> bytes:
    """The GIF of a motion x (F, n, 3), m, at `times` (F,), s, with the target `over` (F, n, 3) over it, and the
    marks of a controlled one.

    The target is NaN where it is unknown. A motion that diverges is shown up to there.
    """
    from PIL import Image

    times, x, over = scenery.good_part(times, x, over)
    beside = marks.seen(x) if marks is not None else [] if over is None else [over]
    on = scenery.stage(scene, [x, *beside], GIF_FACES, GIF_ASPECT, times)
    cut = film(times, () if marks is None else marks.held)
    pictures = [picture(on, times, frame, x, over, width, cut.speed, marks) for frame in cut.frames]
    colours = palette(pictures)
    first, *rest = (one.quantize(palette=colours, dither=Image.Dither.NONE) for one in pictures)
    buffer = io.BytesIO()
    first.save(
        buffer, "GIF", save_all=True, append_images=rest, duration=cut.durations, loop=0, optimize=True, disposal=1
    )
    return buffer.getvalue()


def palette(pictures: list[Image]) -> Image:
    """An image whose palette suits all pictures: that of six of them, and the colours of the ground and the marks."""
    from PIL import Image, ImageColor

    some = [pictures[i] for i in np.unique(np.linspace(0, len(pictures) - 1, 6).round().astype(int))]
    width, height = some[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for row, one in enumerate(some):
        sheet.paste(one, (0, row * height))
    plain = [ImageColor.getrgb(colour) for colour in (FIXED_VERTEX, SEEN_TARGET, GROUND, ARROW)]
    marks = [part for colour in (*plain, *(ink(colour) for _, colour in LEGEND)) for part in colour]
    found = sheet.quantize(PALETTE_SIZE, method=Image.Quantize.MEDIANCUT).getpalette() or []
    made = Image.new("P", (1, 1))
    made.putpalette(found[: 3 * PALETTE_SIZE] + marks)
    return made


def picture(
    on: Stage, times: Array, frame: int, x: Array, over: Array | None, width: int = GIF_WIDTH, speed: float = 1.0,
    marks: Marks | None = None,
) -> Image:  # fmt: skip
    """One frame of a motion x (F, n, 3), with the target `over` (F, n, 3) over it, and marks."""
    from PIL import Image, ImageDraw

    fine = OVERSAMPLING * width
    image = Image.fromarray(scenery.drawn(on, frame, x[frame], None if over is None else over[frame], fine))
    draw = ImageDraw.Draw(image)
    alone, colours = scenery.bare(on, frame, x[frame])
    for (u, v), colour in zip(in_pixels(on, alone, fine).tolist(), np.round(255 * colours).tolist(), strict=True):
        draw.ellipse((u - 6, v - 6, u + 6, v + 6), fill=tuple(map(int, colour)))
    dots = [(scenery.pins(on, frame, x[frame]), FIXED_VERTEX, 5.0)]
    if over is not None:
        dots.insert(0, (scenery.sightings(on, frame, over[frame]), SEEN_TARGET, 3.5))
    if marks is not None:
        dots.append((scenery.dots(on, frame, marks), SEEN_TARGET, 12.0))
        ends = (in_pixels(on, each, fine) for each in scenery.arrows(on, frame, x[frame], marks))
        for tail, tip in zip(*ends, strict=True):
            arrow(draw, 0.5 * (tail + tip), 0.5 * (tip - tail), ARROW, 3)
    for places, mark, radius in dots:
        for u, v in in_pixels(on, places, fine).tolist():
            draw.ellipse((u - radius, v - radius, u + radius, v + radius), fill=mark)
    legend = () if over is None else LEGEND_NAMES if marks is None else marks.legend
    write_caption(draw, image.size, on, times, frame, legend, speed, [] if marks is None else marks.held.tolist())
    return image.resize((width, round(width * on.camera.aspect)), Image.Resampling.BOX)


def write_caption(
    draw: ImageDraw, size: tuple[int, int], on: Stage, times: Array, frame: int,
    legend: Sequence[tuple[str, Colour]], speed: float, keys: Sequence[int],
) -> None:  # fmt: skip
    """Write the time, a bar of progress with the frames of keys, the wind, and what the colours mean, from right to
    left.
    """
    from PIL import ImageFont

    width, height = size
    font = ImageFont.load_default(0.027 * width)
    slowed = "" if speed == 1.0 else f", {1 / speed:.3g} times slower"
    draw.text((0.025 * width, 0.022 * width), f"{times[frame]:.2f} s{slowed}", font=font, fill=GIF_INK)
    right = 0.975 * width
    for name, colour in legend:
        draw.text((right, 0.022 * width), name, font=font, fill=ink(colour), anchor="ra")
        right -= draw.textlength(name, font=font) + 0.025 * width
    share = (times[frame] - times[0]) / max(times[-1] - times[0], 1e-300)
    draw.rectangle((0, height - 5, width, height), fill="#e2e5ea")
    draw.rectangle((0, height - 5, float(share) * width, height), fill=GIF_QUIET)
    found = scenery.wind(on, frame)
    if found is not None:
        way, wind_speed = found
        arrow(draw, np.array([0.075 * width, height - 0.085 * width]), 0.05 * width * way * (1.0, -1.0))
        place = (0.14 * width, height - 0.085 * width)
        draw.text(place, f"wind {wind_speed:.3g} m/s", font=font, fill=GIF_QUIET, anchor="lm")
    for time in times[list(keys)]:
        at = float((time - times[0]) / max(times[-1] - times[0], 1e-300)) * (width - 1)
        draw.rectangle((at - 3, height - 14, at + 3, height), fill=SEEN_TARGET)
    if frame in keys:
        draw.text((0.025 * width, 0.06 * width), "key", font=font, fill=SEEN_TARGET)


def ink(colour: Colour) -> tuple[int, ...]:
    """A colour dark enough for text."""
    return tuple(round(200 * part) for part in colour)


def arrow(draw: ImageDraw, middle: Array, half: Array, colour: str = GIF_QUIET, wide: int = 4) -> None:
    """Draw an arrow from `middle` − `half` to `middle` + `half`, (2,) in pixels."""
    tip, tail = middle + half, middle - half
    length = max(float(np.linalg.norm(half)), 1e-9)
    along = half / length * min(12.0, 2.0 * length)
    across = 0.5 * along[::-1] * (1.0, -1.0)
    draw.line([*tail, *(tip - along)], fill=colour, width=wide)
    draw.polygon([tuple(tip), tuple(tip - along + across), tuple(tip - along - across)], fill=colour)
