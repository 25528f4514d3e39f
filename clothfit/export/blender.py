"""Blender's cloth modifier: ranges of stiffness, vertex groups between them, and a script that sets them.

Blender's cloth has no SI units: its time unit is a frame (times its speed, `time_scale`), its gravity g/1000 in that
unit, and a structural spring of "stiffness" S has S/L̄, L̄ the mean length of the edges. With

    τ = √0.001 s ≈ 0.0316 s,      S = τ² k L̄,      time_scale = 1 / (frames per second · τ)

its springs carry the same weights at the same stretch, and move as fast; k has what the springs across edges carry
(`membrane`), of which Blender has none. In the same units a damping α m v is an air
damping of 100 τ α m, and c = (α/2) k along a spring is a spring damping of τ c. All vertices have one mass, the mean.

Blender's solver ends at a hundredth. Where dampings c are much larger than m/h, for steps h, that hundredth is more
than the weight, and a light cloth sinks at a constant speed, the more so the more vertices n there are. So c is there
at most h k, or 2 h k as long as n c is at most DAMPING_SPREAD m/h; from DAMPING_LIMIT m/h on. Measured: with less,
small cloths swing up to a quarter too fast, with more large ones fall as much too slowly.

Blender bends by angles: where the faces at an edge of length ℓ are at an angle θ, their two vertices across it feel
0.1 B ℓ θ/(3 τ²) each along their normals, whatever their distance, and the ends of the edge the opposite. A spring k
across the edge, of length L, resists in the third order of the angle, with the torque (k L²/32) θ³. With d the mean
distance of the two vertices from the edge, both torques are equal at the angle FOLD for

    B = τ² k L² FOLD² · 3/(3.2 ℓ d)

These forces are explicit in Blender, so a step h is stable up to h² λ/m = 4, with λ the largest eigenvalue of their
stiffness, at most the largest sum of a row of its absolute values (Gershgorin). B is reduced where this passes
BENDING_LIMIT. The damping of bending is a number of its own for each hinge, whatever its stiffness; with Blender's
default a light cloth explodes. It is 0, as nearly is that of a spring across a flat hinge.

Blender's step is the implicit Euler step, whose damping grows with it. A scene of implicit steps gets steps of the same
length; a scene of other steps, which damp less, a part of its own, FINER. Where h² k/m times the root of the number of
vertices is beyond STIFFNESS_LIMIT, the accuracy of Blender's solver damps much more than that, and the steps are up to
MOST_PARTS parts of these, each of h'. What damping implicit steps so lose, in long waves that of (h − h') k, is added
to c. And with shorter steps the solver bears more damping. Where α/2 is a half of the time √(L/g) in which a cloth of
the size L falls, or more, the damping decides how fast it falls: then c is at most h k for each part. Where it is less,
the whole cloth but sinks too slowly with that, and c has less: with the square of that ratio, down to h k in all.
Measured on ten cloths; with more parts, those with much damping swing as they do not in the scene.

Blender paints weights on vertices: a spring takes the mean of its two ends. With the smallest and the largest value as
the range, k_s ≈ low + (high − low) (w_a + w_b)/2, 0 ≤ w ≤ 1, by least squares. A cloth has three times as many springs
as vertices, so most of the variation from spring to spring is lost.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.export.tools import json_text
from clothfit.export.topology import Roles, edge_stiffness, roles
from clothfit.scene.cloth import Cloth
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene

BLENDER_FORMAT = "clothfit-blender-1"
TIME_UNIT = 0.001**0.5  # τ, s: Blender's time unit, in which its weights are those of SI
FOLD = 0.5  # rad, between two faces: where bending resists as the spring across the hinge does
FINER = 4.0  # steps of Blender's in one of the scene's that is not an implicit Euler step
BENDING_LIMIT = 1.0  # of h² λ/m; 4 is no longer stable
DAMPING_LIMIT = 20.0  # of h c/m, c the damping of a spring, N s/m
STIFFNESS_LIMIT = 2.6e4  # of √n h² k/m, n the number of vertices
MOST_PARTS = 4  # of a step
SLOW = 0.5  # of √(L/g): with an α/2 beyond that, damping decides how fast a cloth falls
GRAVITY = 9.81  # m/s²
DAMPING_SPREAD = 2.8e5  # of n h c/m, n the number of vertices
LARGEST_STIFFNESS = 10_000.0  # Blender's limit
MOST_AIR, MOST_DAMPING = 10.0, 50.0  # the same, of air damping and of the dampings of springs
SCRIPT = Path(__file__).with_name("blender_script.py")
DATA_PLACE = 'json.loads("{}")'  # in the script; the numbers replace it


class Painted(NamedTuple):
    """Weights of n vertices for the values of some springs, and how well they fit."""

    low: float  # value of weight 0
    high: float  # of weight 1
    weights: Array  # (n,), 0 … 1
    deviation: float  # |painted/value − 1|, median over the springs
    largest: float  # the largest


def files(scene: Scene, objects: list[dict[str, Any]] | None = None) -> dict[str, bytes]:
    """The numbers of objects, by default the scene's own, as JSON, and the script, which contains them too."""
    own = [one(number, cloth, *steps_of(scene)) for number, cloth in enumerate(scene.cloths)]
    document = {
        "format": BLENDER_FORMAT,
        "time_unit": TIME_UNIT,
        "gravity": scene.gravity.tolist(),
        "step": steps_of(scene)[0],
        "objects": own if objects is None else objects,
    }
    text = json_text(document, "blender")
    script = SCRIPT.read_text("utf-8").replace(DATA_PLACE, f"json.loads({text!r})")
    return {"blender.json": text.encode(), "blender.py": script.encode()}


def steps_of(scene: Scene) -> tuple[float, int]:
    """The longest step for Blender, s, and how many of them there are in what the scene's step would be there."""
    whole = scene.delta if INTEGRATORS[scene.method] == "implicit" else scene.delta / FINER
    parts = max((parts_of(cloth, whole) for cloth in scene.cloths), default=1)
    return whole / parts, parts


def parts_of(cloth: Cloth, step: float) -> int:
    """In how many parts Blender must take a step, s, so that its solver's accuracy does not decide."""
    role = roles(cloth)
    stiffness = edge_stiffness(cloth, role)[~role.bending]
    if not len(stiffness):
        return 1
    found = len(cloth.mass) ** 0.5 * step**2 * float(stiffness.mean()) / float(cloth.mass.mean())
    return int(np.clip(np.ceil((found / STIFFNESS_LIMIT) ** 0.5), 1, MOST_PARTS)) if np.isfinite(found) else MOST_PARTS


def one(number: int, cloth: Cloth, step: float, parts: int = 1) -> dict[str, Any]:
    """The values of an object for Blender, for steps of at most `step`, s, which are parts of a longer one."""
    role = roles(cloth)
    edges = ~role.bending
    length = float(cloth.rest[edges].mean()) if edges.any() else 0.0
    count, mass = len(cloth.mass), float(cloth.mass.mean())
    stiffness = edge_stiffness(cloth, role)[edges]
    traction = painted(count, cloth.springs[edges], TIME_UNIT**2 * length * stiffness)
    bending = painted(count, role.hinges[role.bending], bending_of(cloth, role, step))
    along = TIME_UNIT * damping_of(cloth, stiffness, step, parts)
    return {
        "object": number,
        "vertices": count,
        "mass": mass,
        "air_damping": min(100.0 * TIME_UNIT * cloth.damping * mass, MOST_AIR),
        "spring_damping": min(along, MOST_DAMPING),
        "mean_length": length,
        "structural": group(traction),
        "bending": group(bending),
        "pin": np.flatnonzero(cloth.fixed).tolist(),
    }


def damping_of(cloth: Cloth, stiffness: Array, step: float, parts: int = 1) -> float:
    """The damping of the springs along edges, N s/m, with steps of `step`, s, so many in a longer one; 0 without
    springs.
    """
    if not len(stiffness):
        return 0.0
    k, mass, whole = float(stiffness.mean()), float(cloth.mass.mean()), step * parts
    more = min(2.0 * whole * k, DAMPING_SPREAD * mass / (len(cloth.mass) * whole))
    own = 0.5 * cloth.damping * k + (whole - step) * k
    return min(own, max(borne(cloth, parts) * whole * k, more, DAMPING_LIMIT * mass / whole))


def borne(cloth: Cloth, parts: int) -> float:
    """How many h k of damping a cloth gets at most, for steps that are so many parts of h: 1 to `parts`."""
    fall = (float(np.ptp(cloth.positions, axis=0).max()) / GRAVITY) ** 0.5  # s
    slow = 0.5 * cloth.damping / (SLOW * fall) if fall > 0 else 1.0
    return 1.0 + (parts - 1) * min(slow, 1.0) ** 2


def bending_of(cloth: Cloth, role: Roles, step: float) -> Array:
    """Blender's stiffnesses of the hinges under the bending springs, stable with steps of `step`, s."""
    ends, hinges = cloth.springs[role.bending], role.hinges[role.bending]
    length: Array = np.linalg.norm(cloth.positions[hinges[:, 1]] - cloth.positions[hinges[:, 0]], axis=1)
    torque = cloth.stiffness[role.bending] * (cloth.rest[role.bending] * FOLD) ** 2 / 32  # N m per rad
    with np.errstate(all="ignore"):  # a face without area
        slope = slopes(cloth.positions, ends, hinges)
        force = torque * 2.0 / (1.0 / slope[:, :2]).sum(axis=1)  # N per rad, of each of the four vertices
        made: Array = np.divide(3.0 * TIME_UNIT**2 * force, 0.1 * length, out=np.zeros_like(length), where=length > 0)
        rows = np.repeat((force * slope.sum(axis=1))[:, None], 4, axis=1)
    largest = np.zeros(len(cloth.mass))
    np.add.at(largest, np.hstack([ends, hinges]), rows)
    ratio = step**2 * float(largest.max(initial=0.0)) / float(cloth.mass.mean())
    if not np.isfinite(ratio):
        return np.zeros_like(made)
    return made * min(1.0, BENDING_LIMIT / ratio) if ratio > 0 else made


def slopes(positions: Array, ends: Indices, hinges: Indices) -> Array:
    """|∂θ/∂x|, rad/m, of flat hinges by the two vertices across each and the two on it: (hinges, 4).

    A vertex at a distance d across moves the angle by 1/d; the hinge's ends take that in the shares of its foot.
    """
    a, along = positions[hinges[:, 0]], positions[hinges[:, 1]] - positions[hinges[:, 0]]
    found: Array = np.zeros((len(ends), 4))
    for side in (0, 1):
        away = positions[ends[:, side]] - a
        foot = (away * along).sum(axis=1) / (along * along).sum(axis=1)
        found[:, side] = 1 / np.linalg.norm(away - foot[:, None] * along, axis=1)
        found[:, 2] += (1 - foot) * found[:, side]
        found[:, 3] += foot * found[:, side]
    sizes: Array = np.abs(found)
    return sizes


def group(found: Painted | None) -> dict[str, Any] | None:
    """Range and weights of a vertex group, in Blender's units."""
    if found is None:
        return None
    return {
        "stiffness": min(found.low, LARGEST_STIFFNESS),
        "stiffness_max": min(found.high, LARGEST_STIFFNESS),
        "weights": found.weights.tolist(),
        "median_deviation": found.deviation,
        "largest_deviation": found.largest,
    }


def painted(count: int, ends: Indices, values: Array) -> Painted | None:
    """Find the weights of `count` vertices for values at pairs of them, `ends` (S, 2); None without values."""
    if not len(values):
        return None
    low, high = float(values.min()), float(values.max())
    weights = np.zeros(count)
    if high > low:
        weights = fitted(count, ends, (values - low) / (high - low))
    made = low + (high - low) * weights[ends].mean(axis=1)
    gaps = np.abs(made - values) / np.where(values > 0, values, np.inf)
    return Painted(low, high, weights, float(np.median(gaps)), float(gaps.max()))


def fitted(count: int, ends: Indices, wanted: Array) -> Array:
    """Weights (count,) within 0 … 1 whose means at the ends are nearest to the `wanted` values, within 0 … 1."""
    from scipy.optimize import lsq_linear
    from scipy.sparse import csr_array

    rows = np.repeat(np.arange(len(wanted)), 2)
    halves = csr_array((np.full(len(rows), 0.5), (rows, ends.reshape(-1))), shape=(len(wanted), count))
    found = lsq_linear(halves, wanted, bounds=(0.0, 1.0), lsmr_tol="auto").x
    return np.clip(found, 0.0, 1.0)
