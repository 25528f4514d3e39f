"""Parameters on the cloth: masses on the vertices, stiffnesses on the springs, drawn where they are at the start."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.objective.identifiability import identifiable
from clothfit.pictures.camera import Camera, facing, project, shaped
from clothfit.pictures.filmstrip import MOST_VECTOR_SHAPES
from clothfit.pictures.palette import GROUND, INK, NOT_IDENTIFIABLE, QUIET
from clothfit.scene.fit_vector import parameters
from clothfit.scene.kinds import KIND, Kind
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

LOGARITHMIC_ABOVE = 6.0
"""Values of one kind that differ by more than this factor have a logarithmic colour bar."""

MOST_MAP_VALUES = 20_000
"""Values of a map; of more, so many are drawn, taken at random."""

MAP_ASPECT = (0.5, 1.0)  # height by width of a map, at least and at most


class Map(NamedTuple):
    """The values of one kind, of all objects."""

    kind: Kind
    places: Array  # (K, 3) of vertices, or (K, 2, 3) of the ends of springs, m
    values: Array  # (K,)
    known: Flags  # (K,) whether the motion can show it
    relative: bool = False  # whether they are deviations, fitted / true − 1


def maps(scene: Scene, truth: Scene | None = None) -> list[Map]:
    """What a scene flags with a value for each vertex or spring; the deviations from `truth` where that is given."""
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
    return [joined(KIND[name], parts, truth is not None) for name, parts in found.items()]


def joined(kind: Kind, parts: Sequence[tuple[Array, Array, Flags]], relative: bool) -> Map:
    """A map of all objects from one for each: places, values, and which of them are known; of very many some."""
    places, values, known = (np.concatenate([part[i] for part in parts]) for i in range(3))
    if len(values) > MOST_MAP_VALUES:
        some = np.sort(np.random.default_rng(0).choice(len(values), MOST_MAP_VALUES, replace=False))
        places, values, known = places[some], values[some], known[some]
    return Map(kind, places, values, known.astype(bool), relative)


def deviation(values: Array, true: Array) -> Array:
    """Relative deviations (K,) of values (K, c), of vectors in length; NaN where the true one is 0."""
    size = np.linalg.norm(true, axis=1)
    away = values[:, 0] - true[:, 0] if values.shape[1] == 1 else np.linalg.norm(values - true, axis=1)
    return np.where(size > 0, away / np.where(size > 0, size, 1.0), np.nan)


def draw(axes: Axes, shown: Map) -> None:
    """Draw a map with its colour bar; what the motion cannot show is grey."""
    points = shown.places.reshape(-1, 3)
    seen = shaped(facing(points), *MAP_ASPECT)
    flat = project(seen, shown.places)[..., :2]
    norm = scale(shown)
    drawn: Any = (vertices if shown.kind.of == "vertex" else springs)(axes, seen, flat, shown, norm)
    axes.set(xlim=(seen.low[0], seen.high[0]), ylim=(seen.low[1], seen.high[1]), xticks=[], yticks=[], aspect="equal",
             facecolor=GROUND)  # fmt: skip
    axes.spines[:].set_visible(False)
    title = f"{shown.kind.title}: deviation from the truth" if shown.relative else f"{shown.kind.title}, fitted"
    axes.set_title(title, loc="left", fontsize=10, color=INK, pad=5)
    hidden = int((~shown.known).sum())
    if hidden:
        axes.set_xlabel(f"grey: {hidden} that the motion cannot show", fontsize=8, color=QUIET)
    colour_bar(axes, drawn, shown)


def colour_bar(axes: Axes, drawn: Any, shown: Map) -> None:
    """The scale beside a map, with its unit."""
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure: Any = axes.figure
    ends = "both" if shown.relative and beyond(shown) else "neither"
    bar = figure.colorbar(drawn, ax=axes, fraction=0.05, pad=0.03, extend=ends)
    if isinstance(drawn.norm, LogNorm):
        bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
    bar.set_label("fitted / true − 1" if shown.relative else f"{shown.kind.title}, {shown.kind.unit}", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)


def beyond(shown: Map) -> bool:
    """Whether some deviations are larger than the colours reach."""
    return bool((np.abs(shown.values[shown.known]) > reach(shown)).any())


def reach(shown: Map) -> float:
    """The deviation at which the colours end: all but the largest two in a hundred are within."""
    sizes = np.abs(shown.values[shown.known])
    return max(float(np.quantile(sizes, 0.98)) if len(sizes) else 0.0, 1e-12)


def scale(shown: Map) -> Normalize:
    """From values to colours."""
    from matplotlib.colors import LogNorm, Normalize

    values = shown.values[shown.known]
    if shown.relative:
        return Normalize(-reach(shown), reach(shown))
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    if low > 0 and high > LOGARITHMIC_ABOVE * low:
        return LogNorm(low, high)
    room = max(0.5e-3 * abs(high), 0.02 * (high - low), 1e-12) if high - low < 1e-3 * abs(high) else 0.0
    return Normalize(low - room, high + room)


def vertices(axes: Axes, seen: Camera, flat: Array, shown: Map, norm: Normalize) -> Any:
    """A dot for each vertex, about as large as there is room."""
    size = seen.high - seen.low
    inches = 2.6 / float(size[0])
    area = float(np.clip(0.5 * size.prod() / max(len(flat), 1) * (72 * inches) ** 2, 0.3, 90.0))
    lost = ~shown.known
    axes.scatter(flat[lost, 0], flat[lost, 1], s=0.4 * area, c=NOT_IDENTIFIABLE, linewidths=0)
    own = flat[shown.known]
    return axes.scatter(
        own[:, 0], own[:, 1], s=area, c=shown.values[shown.known], cmap=colours(shown), norm=norm, edgecolors="#b4bac4",
        linewidths=0.4 if shown.relative and area > 8.0 else 0.0, rasterized=len(flat) > MOST_VECTOR_SHAPES,
    )  # fmt: skip


def springs(axes: Axes, seen: Camera, flat: Array, shown: Map, norm: Normalize) -> Any:
    """A line for each spring, the long ones below."""
    from matplotlib.collections import LineCollection

    length = np.linalg.norm(flat[:, 0] - flat[:, 1], axis=1)
    order = np.argsort(-length, kind="stable")
    flat, values, known, length = flat[order], shown.values[order], shown.known[order], length[order]
    thick, dots = float(np.clip(50.0 / np.sqrt(max(len(flat), 1)), 0.15, 2.4)), len(flat) > MOST_VECTOR_SHAPES
    width = thick * np.clip(np.median(length) / np.maximum(length, 1e-300), 0.3, 1.0)
    lost = LineCollection(list(flat[~known]), colors=NOT_IDENTIFIABLE, linewidths=0.5 * width[~known], rasterized=dots)
    axes.add_collection(lost, autolim=False)
    lines = LineCollection(list(flat[known]), cmap=colours(shown), norm=norm, linewidths=width[known], rasterized=dots)
    lines.set_array(values[known])
    axes.add_collection(lines, autolim=False)
    return lines


def colours(shown: Map) -> str:
    """The name of the colour map: one with a middle for deviations."""
    return "coolwarm" if shown.relative else "viridis"


def single_values(scene: Scene, truth: Scene | None = None) -> Sequence[str]:
    """A line for each value that is one for a whole object, or for the scene: what it is, and the true one."""
    flags = scene if truth is None else truth
    p, told = parameters(scene, flags=flags), []
    for block in flags.blocks:
        if block.mode == "G" or block.cloth is None:
            place = "scene" if block.cloth is None else f"objects[{block.cloth}]"
            unit = block.kind.unit if block.unit is None else "× that at the start"
            words = f"{place} {block.kind.title} {vector(p[block.part])} {unit}"
            told.append(words if truth is None else f"{words} (true: {vector(parameters(truth)[block.part])})")
    return told


def vector(values: Array) -> str:
    """A number, or several in brackets."""
    told = [f"{value:.4g}" for value in values.tolist()]
    return told[0] if len(told) == 1 else f"({', '.join(told)})"
