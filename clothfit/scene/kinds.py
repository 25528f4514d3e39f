"""The kinds of parameter that a fit can find: a table with one row each.

A kind belongs to each vertex, spring, key of a pin, object or collider (the contact of cloths with themselves is one),
or to the scene as a whole. Masses and stiffnesses are flagged by the two letters of an object's `optimizationSettings`,
every other kind by its field's name in the `fit` of its object or of the scene. Mode G is one value for the whole
object (for rest lengths one factor on the lengths at `vertPos`) or for all contacts, L one value per vertex, spring,
key or contact. Modes F, R and M are factors on the values that the scene has (`factors`): one for all, one for each
group of vertices or springs, a smooth map of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Kind:
    """One kind of parameter; bounds, scale and start are in its unit, per component."""

    name: str  # of the field in `arrays.Elements`, of the attribute of Cloth or Scene, and in reports
    title: str  # in messages
    field: str  # of the scene file
    of: str  # what each has one: "vertex", "spring", "key" of its pins, "object", "collider" or "scene"
    modes: str  # the possible modes besides n
    components: int  # 3 for vectors
    unit: str  # empty: none
    valid: str  # the range of values in a scene: "above 0", "0 or more" or "any number"
    lower: float  # bounds of a fit where neither the values nor the scene ask for others (`bounds`)
    upper: float
    log: bool  # whether a fit moves its logarithm, or the value itself
    scale: float = 1.0  # typical size, where a fit moves the value itself
    neutral: tuple[float, ...] = (1.0,)  # start of a fit that must not use the scene's value; for lengths the factor

    @property
    def suffix(self) -> str:
        """The unit behind a number, with a space before it; nothing where there is none."""
        return f" {self.unit}" if self.unit else ""


ZERO = (0.0, 0.0, 0.0)

KINDS = (
    Kind("mass", "mass", "vertMass", "vertex", "FRMGL", 1, "kg", "above 0", 1e-4, 1e4, True),
    Kind("stiffness", "stiffness", "springStiffness", "spring", "FRMGL", 1, "N/m", "0 or more", 1e-4, 1e4, True),
    Kind("damping", "damping", "damping", "object", "G", 1, "1/s", "0 or more", 0.0, 1e4, False, neutral=(0.1,)),
    Kind("drag", "drag", "dragCoefficient", "object", "G", 1, "kg/(m^6 s)", "0 or more", 0.0, 1e4, False),
    Kind("velocity", "velocity", "vertVel", "vertex", "GL", 3, "m/s", "any number", -1e4, 1e4, False, 1.0, ZERO),
    Kind("rest", "rest length", "springRestLength", "spring", "FRMGL", 1, "m", "above 0", 1e-4, 1e4, True),
    Kind("path", "path of the pins", "posKeys", "key", "L", 3, "m", "any number", -1e4, 1e4, False, 0.1, ZERO),
    Kind("shift", "offset of the pins", "pinOffset", "object", "G", 3, "m", "any number", -1e4, 1e4, False, 0.1, ZERO),
    # not 0: in still air a flat cloth stays flat, and reveals no wind along it
    Kind("wind", "wind", "windVel", "scene", "G", 3, "m/s", "any number", -1e4, 1e4, False, 5.0, (0.1, 0.1, 0.1)),
    Kind("gravity", "gravity", "gravity", "scene", "G", 3, "m/s²", "any number", -1e4, 1e4, False, 10.0,
         (0.0, -9.81, 0.0)),
    # the air's push grows with drag times wind: where drag is fitted to little, the wind is fast
    Kind("gusts", "wind over time", "windVelKeys", "scene", "L", 3, "m/s", "any number", -1e6, 1e6, False, 5.0,
         (0.1, 0.1, 0.1)),
    Kind("friction", "friction", "friction", "collider", "GL", 1, "", "0 or more", 0.0, 10.0, False, 0.5, (0.3,)),
    Kind("contact", "contact stiffness", "contact", "collider", "GL", 1, "N/m", "above 0", 1.0, 1e6, True, 1.0,
         (1000.0,)),
    Kind("offset", "offset of the colliders", "colliderOffset", "scene", "G", 3, "m", "any number", -1e4, 1e4, False,
         0.1, ZERO),
)  # fmt: skip
"""In the order of the fit vector: those of each object in turn, then those of the scene."""

KIND = {kind.name: kind for kind in KINDS}
SCENE_KINDS = tuple(kind for kind in KINDS if kind.of in ("scene", "collider"))
CLOTH_KINDS = tuple(kind for kind in KINDS if kind not in SCENE_KINDS)
LETTERED = ("mass", "stiffness")
"""The kinds that `optimizationSettings` flags, in the order of its letters."""

AUTO = "auto"
"""In place of what to fit: the fit chooses by itself."""

AIR_DENSITY = 1.2
"""Of air, kg/m³."""

DRAG_LAWS = EDITORS, AIR = "editor", "air"
"""Values of an object's `dragLaw`."""

PLATE = 1.2
"""The drag coefficient of a plate that faces the air, in the law "air"."""

DRAG_IN_AIR = replace(KIND["drag"], unit="", upper=100.0, neutral=(PLATE,))
"""The kind "drag" of an object with that law."""

INTEGRATORS = ("explicit", "symplectic", "implicit", "bdf2", "rest")
"""Names of the values of integrationMethod."""

REST = len(INTEGRATORS) - 1
"""The last: every frame is the shape at rest."""

OF_THE_EDITOR = INTEGRATORS[:3]
"""Those that the editor has."""

MODELS = "FRML"
"""Modes of masses, stiffnesses and rest lengths from coarse to fine; of G, one value for all, none is finer or coarser.
"""

MODEL_NAMES = {"F": "one factor", "R": "families", "M": "maps", "L": "single values", "G": "one value"}
