"""What a tool does not get is told, for each field that a scene may have."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.physics import xyz
from helpers.scenes import cloth, document

from clothfit import load
from clothfit.export.dropped import FIELDS, SOLVERS, dropped

SCHEMA = json.loads((Path(__file__).parents[2] / "schemas" / "scene.schema.json").read_text("utf-8"))


def test_every_field_of_the_schema_has_its_row():
    own, nested = SCHEMA["$defs"]["object"]["properties"], ("objects", "colliders")
    fields = {name for name in SCHEMA["properties"] if name not in nested} | {f"objects.{name}" for name in own}
    assert set(FIELDS) == fields | {"colliders.*"}


WIND = {"times": [0, 1], "values": [xyz((0, 0, 0)), xyz((1, 0, 0))]}


@pytest.mark.parametrize(
    ("more", "what", "tools"),
    [
        ({"windVel": xyz((1, 0, 0))}, "its wind", SOLVERS),
        ({"windVelKeys": WIND}, "its wind over time", SOLVERS),
        ({"gravity": xyz((0, -1.6, 0))}, "its gravity, which is not 9.81 m/s² downwards", SOLVERS),
        ({"gravityKeys": WIND}, "its gravity over time", SOLVERS),
        ({"frame": {"posKeys": WIND}}, "its moving frame of reference", SOLVERS),
        ({"selfCollision": {"thickness": 0.01}}, "the contact of cloths with themselves", SOLVERS),
        ({"colliders": [{"type": 1, "pos": xyz((0, -1, 0)), "scale": xyz((1, 1, 1))}]}, "its colliders", SOLVERS),
        ({"damping": 0.3}, "its damping", ("obi",)),
        ({"vertVel": [xyz((0, 1, 0))] * 9}, "its velocities at the start", SOLVERS),
        ({"pins": [{"vertices": [0], "posKeys": WIND}]}, "the paths of its pins", SOLVERS),
    ],
)  # fmt: skip
def test_what_a_scene_has_is_told_by_each_tool_that_does_not_get_it(more, what, tools):
    plain = {**cloth(3, 3), "dragCoefficient": 0, "damping": 0, "vertIsFixed": [True] + [False] * 8}
    of_object = {name: value for name, value in more.items() if name in ("damping", "vertVel", "pins")}
    others = {name: value for name, value in more.items() if name not in of_object}
    calm = load(document(objects=[plain]))
    assert np.allclose(calm.gravity, [0, -9.81, 0])
    drag = {"dragCoefficient": 0.1} if "wind" in what else {}
    scene = load(document(objects=[plain | of_object | drag], **others))
    for tool in (*SOLVERS, "gltf", "usd"):
        assert dropped(calm, tool) == []
        assert (what in dropped(scene, tool)) == (tool in tools)
