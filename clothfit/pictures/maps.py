"""Maps of parameters on the cloth at its start: masses at the vertices, stiffnesses along the springs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.objective.identifiability import identifiable
from clothfit.pictures.camera import Camera, facing, project, shaped
from clothfit.pictures.charts import blank, logarithmic_ticks
from clothfit.pictures.picture_file import INK, NOT_IDENTIFIABLE, QUIET
from clothfit.scene.fit_vector import parameters
from clothfit.scene.kinds import KIND, Kind
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

LOGARITHMIC_ABOVE = 6.0
"""Values whose largest and smallest differ by more than this factor get a logarithmic colour bar."""

MOST_MAP_VALUES = 20_000
"""Most values in a map; of more, a random sample is drawn."""

MOST_VECTOR_SHAPES = 3000
"""Most shapes that a .svg or .pdf holds as such; more are stored as an image."""

MAP_ASPECT = (0.5, 1.0)  # height by width of a map, at least and at most
COLOURS = ("viridis", "coolwarm")  # of values, and of deviations, which diverge from a middle


class Map(NamedTuple):
    """The values of one kind, of all objects."""

    kind: Kind
    places: Array  # (K, 3) vertices, or (K, 2, 3) ends of springs, m
    values: Array  # (K,)
    known: Flags  # (K,) whether the motion determines the value
    relative: bool = False  # whether the values are deviations, fitted / true − 1


def maps(scene: Scene, truth: Scene | None = None) -> list[Map]:
    """Maps of all kinds fitted with a value for each vertex or spring; with `truth`, of their deviations from it."""
    flags = scene if truth is None else truth
    p, shown = parameters(scene, flags=flags), identifiable(flags)
    found: dict[str, list[tuple[Array, Array, Flags]]] = {}
    for block in flags.blocks:
        if block.mode == "L" and block.cloth is not None:
            cloth = scene.cloths[block.cloth]
            places = cloth.positions if block.kind.of == "vertex" else cloth.positions[cloth.springs]
            values, known = p[block.part].reshape(len(places), -1), shown[block.part].reshape(len(places), -1)
            size = np.linalg.norm(values, axis=1) if values.shape[1] > 1 else values[:, 0]
            if truth is not None:
                size = deviation(values, parameters(truth)[block.part].reshape(values.shape))
            found.setdefault(block.name, []).append((places, size, known.all(axis=1) & np.isfinite(size)))
    made = []
    for name, parts in found.items():
        places, values, known = (np.concatenate(each) for each in zip(*parts, strict=True))
        if len(values) > MOST_MAP_VALUES:
            some = np.sort(np.random.default_rng(0).choice(len(values), MOST_MAP_VALUES, replace=False))
            places, values, known = places[some], values[some], known[some]
        made.append(Map(KIND[name], places, values, known.astype(bool), truth is not None))
    return made


def deviation(values: Array, true: Array) -> Array:
    """Relative deviations (K,) of values (K, c), of vectors by length; NaN where the true value is 0."""
    size = np.linalg.norm(true, axis=1)
    away = values[:, 0] - true[:, 0] if values.shape[1] == 1 else np.linalg.norm(values - true, axis=1)
    return np.where(size > 0, away / np.where(size > 0, size, 1.0), np.nan)


def draw(axes: Axes, field: Map) -> None:
    """Draw a map with its colour bar; values that the motion does not determine are grey."""
    points = field.places.reshape(-1, 3)
    seen = shaped(facing(points), *MAP_ASPECT)
    flat = project(seen, field.places)[..., :2]
    norm = scale(field)
    drawn: Any = (vertices if field.kind.of == "vertex" else springs)(axes, seen, flat, field, norm)
    blank(axes, seen)
    title = f"{field.kind.title}: deviation" if field.relative else f"{field.kind.title}, fitted"
    axes.set_title(title, loc="left", fontsize=10, color=INK, pad=5)
    hidden = int((~field.known).sum())
    if hidden:
        axes.set_xlabel(f"grey: {hidden} that the motion cannot show", fontsize=8, color=QUIET)
    colour_bar(axes, drawn, field)


def colour_bar(axes: Axes, drawn: Any, field: Map) -> None:
    """Draw the scale beside a map, with its unit."""
    from matplotlib.colors import LogNorm

    figure: Any = axes.figure
    beyond = field.relative and (np.abs(field.values[field.known]) > reach(field)).any()
    ends = "both" if beyond else "neither"
    bar = figure.colorbar(drawn, ax=axes, fraction=0.05, pad=0.03, extend=ends)
    if isinstance(drawn.norm, LogNorm):
        logarithmic_ticks(bar.ax.yaxis, (1.0, 2.0, 5.0), 12)
    bar.set_label("fitted / true − 1" if field.relative else f"{field.kind.title}, {field.kind.unit}", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)


def reach(field: Map) -> float:
    """The deviation at which the colours end: 98 % of the deviations are within it."""
    sizes = np.abs(field.values[field.known])
    return max(float(np.quantile(sizes, 0.98)) if len(sizes) else 0.0, 1e-12)


def scale(field: Map) -> Normalize:
    """The normalisation of values to colours."""
    from matplotlib.colors import LogNorm, Normalize

    values = field.values[field.known]
    if field.relative:
        return Normalize(-reach(field), reach(field))
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    if low > 0 and high > LOGARITHMIC_ABOVE * low:
        return LogNorm(low, high)
    room = max(0.5e-3 * abs(high), 0.02 * (high - low), 1e-12) if high - low < 1e-3 * abs(high) else 0.0
    return Normalize(low - room, high + room)


def vertices(axes: Axes, seen: Camera, flat: Array, field: Map, norm: Normalize) -> Any:
    """Draw a dot for each vertex, sized to fill the cloth."""
    size = seen.high - seen.low
    inches = 2.6 / float(size[0])
    area = float(np.clip(0.5 * size.prod() / max(len(flat), 1) * (72 * inches) ** 2, 0.3, 90.0))
    lost = ~field.known
    axes.scatter(flat[lost, 0], flat[lost, 1], s=0.4 * area, c=NOT_IDENTIFIABLE, linewidths=0)
    own = flat[field.known]
    return axes.scatter(
        own[:, 0], own[:, 1], s=area, c=field.values[field.known], cmap=COLOURS[field.relative], norm=norm,
        edgecolors="#b4bac4", linewidths=0.4 if field.relative and area > 8.0 else 0.0,
        rasterized=len(flat) > MOST_VECTOR_SHAPES,
    )  # fmt: skip


def springs(axes: Axes, seen: Camera, flat: Array, field: Map, norm: Normalize) -> Any:
    """Draw a line for each spring, long ones first so that short ones lie above them."""
    from matplotlib.collections import LineCollection

    length = np.linalg.norm(flat[:, 0] - flat[:, 1], axis=1)
    order = np.argsort(-length, kind="stable")
    flat, values, known, length = flat[order], field.values[order], field.known[order], length[order]
    thick, dots = float(np.clip(50.0 / np.sqrt(max(len(flat), 1)), 0.15, 2.4)), len(flat) > MOST_VECTOR_SHAPES
    width = thick * np.clip(np.median(length) / np.maximum(length, 1e-300), 0.3, 1.0)
    lost = LineCollection(list(flat[~known]), colors=NOT_IDENTIFIABLE, linewidths=0.5 * width[~known], rasterized=dots)
    axes.add_collection(lost, autolim=False)
    colours = {"cmap": COLOURS[field.relative], "norm": norm}
    lines = LineCollection(list(flat[known]), linewidths=width[known], rasterized=dots, **colours)  # type: ignore[arg-type]
    lines.set_array(values[known])
    axes.add_collection(lines, autolim=False)
    return lines


def single_values(scene: Scene, truth: Scene | None = None) -> Sequence[str]:
    """A line for each value that belongs to a whole object or to the scene, with the true value where it is known."""
    flags = scene if truth is None else truth
    p, lines = parameters(scene, flags=flags), []
    for block in flags.blocks:
        if block.mode == "G" or block.cloth is None:
            place = "scene" if block.cloth is None else f"objects[{block.cloth}]"
            unit = block.kind.suffix if block.unit is None else " × that at the start"
            line = f"{place} {block.kind.title} {vector(p[block.part])}{unit}"
            lines.append(line if truth is None else f"{line} (true: {vector(parameters(truth)[block.part])})")
    return lines


def vector(values: Array) -> str:
    """A number, or several in brackets."""
    numbers = [f"{value:.4g}" for value in values.tolist()]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
