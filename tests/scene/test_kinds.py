"""The kinds of parameter: what a scene asks for, the fit vector and the way back, and what cannot be fitted."""

import json
import re

import numpy as np
import pytest
from helpers.physics import ball, scene, thing, xyz
from helpers.scenes import changed, cloth, document, load_text, problems

from clothfit import load
from clothfit.base.arrays import Elements
from clothfit.base.errors import InvalidScene
from clothfit.engine.system import all_elements, build, with_elements
from clothfit.objective.identifiability import identifiable, unobservable
from clothfit.scene import schema as structure
from clothfit.scene.bounds import of_factor
from clothfit.scene.fit_vector import bounds, changes, elements, fitted_cloths, parameters, with_parameters
from clothfit.scene.kinds import CLOTH_KINDS, KINDS, LETTERED, SCENE_KINDS
from clothfit.scene.scene import dumps

EVERY = {"damping": "G", "dragCoefficient": True, "vertVel": "g", "springRestLength": "L"}
SCHEMA = json.loads(structure.schema_path().read_text("utf-8"))


def full(modes=EVERY, whole=("windVel", "gravity"), **fields):
    """A scene that fits every kind: two cloths, of which the second has only masses to fit."""
    one = cloth(3, 3, fit=modes, optimizationSettings="GL", dragCoefficient=0.4, damping=0.7, **fields)
    fit = dict.fromkeys(whole, True)
    return document(one, cloth(2, 2, optimizationSettings="Ln"), windVel=xyz((3, 1, -2)), fit=fit)


# What a scene asks for ------------------------------------------------------------------------------------------------


def test_the_table_names_the_elements_and_the_fields_of_the_schema():
    assert (*(kind.name for kind in KINDS), "force") == Elements._fields  # forces are not fitted
    assert tuple(kind.name for kind in KINDS[:2]) == LETTERED
    asked = [kind for kind in KINDS if kind.name not in LETTERED]
    own, whole = (part["properties"] for part in (SCHEMA["$defs"]["object"], SCHEMA))
    for kind in KINDS:
        assert kind.of in ("collider", "key") or kind.field in (whole if kind in SCENE_KINDS else own)
    for properties, kinds in ((own, CLOTH_KINDS), (whole, SCENE_KINDS)):
        fields = dict(properties["fit"]["properties"])
        bounded = CLOTH_KINDS if kinds is CLOTH_KINDS else KINDS
        assert set(fields.pop("bounds")["properties"]) == {name for k in bounded for name in (k.name, k.field)}
        modes = {name: field["enum"] for name, field in fields.items()}
        assert set(modes) == {kind.field for kind in kinds if kind in asked}
        for kind in kinds:
            letters = {letter for letter in modes.get(kind.field, []) if isinstance(letter, str)}
            assert letters in (set(), {"n", "N", *kind.modes, *kind.modes.lower()})


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("fit",), {"wind": True}, "fit.wind: cannot be fitted; windVel, gravity, windVelKeys, friction, contact, "),
        (("objects", 0, "fit"), {"vertMass": "G"}, "objects[0].fit.vertMass: cannot be fitted; damping, drag"),
        (("objects", 0, "vertVel"), [xyz((0, 0, 0))], "objects[0].vertVel: 1 value for 12 vertices; one each"),
        (("objects", 0, "springRestLength"), [1.0], "objects[0].springRestLength: 1 value for 23 springs; one each"),
        (("objects", 0, "springRestLength"), [0.0] + [1.0] * 22, "objects[0].springRestLength[0]: the rest length"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_place(path, value, message):
    with pytest.raises(InvalidScene, match=f"^scene: {re.escape(message)}"):
        load(changed(document(), path, value))


def test_values_that_a_file_may_leave_out():
    text = json.dumps(document())
    made = load_text(text)
    assert dumps(made).decode() == text
    one = made.cloths[0]
    assert made.gravity.tolist() == [0, -9.81, 0]
    assert one.velocity.tolist() == [[0, 0, 0]] * 12
    np.testing.assert_array_equal(one.rest, one.lengths)
    assert one.lengths[:2].tolist() == [1.0, 1.0]


def test_letters_and_switches():
    for asked, mode in (("n", "n"), ("G", "G"), ("l", "L"), (True, "G"), (False, "n"), ("g", "G")):
        made = load(document(cloth(fit={"vertVel": asked}), fit={"gravity": mode == "G"}))
        assert made.cloths[0].mode("velocity") == mode
        assert made.mode("gravity") == ("G" if mode == "G" else "n")


# There and back -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("modes", [EVERY, {**EVERY, "vertVel": "L", "springRestLength": "G"}])
def test_parameters_come_back_from_the_scene_and_from_its_file(modes):
    first = load(full(modes))
    p = parameters(first) * 1.25 + 0.125
    made = with_parameters(first, p)
    again = load_text(dumps(made))
    # the mean of equal numbers, and a factor from its products, round
    np.testing.assert_allclose(parameters(made), p, rtol=1e-14)
    np.testing.assert_array_equal(parameters(again), parameters(made))
    for mine, its in zip(all_elements(build(made, 0)), all_elements(build(again, 0)), strict=True):
        np.testing.assert_array_equal(mine, its)


RUBS = {"type": 3, "pos": xyz((0, -1, 0)), "scale": xyz((1, 1, 1)), "friction": 0.25}
FLOOR = {"type": 0, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1))}
OBSTACLES = [FLOOR, RUBS, ball((1, 0, 0), 0.5), {**RUBS, "stiffness": 5e3}]


@pytest.mark.parametrize(
    ("mode", "friction", "contact"), [("L", [0.5, 0.125], [2e3, 3e3]), ("G", [0.5] * 2, [2e3] * 2)]
)
def test_the_laws_of_colliders_and_their_offset_go_into_the_file(mode, friction, contact):
    asked = {"friction": mode, "contact": mode, "colliderOffset": "G"}
    text = json.dumps(document(cloth(2, 2), fit=asked, colliders=OBSTACLES))
    first = load_text(text)
    assert dumps(first).decode() == text
    assert [block.name for block in first.blocks] == ["friction", "contact", "offset"]
    own = 2 if mode == "L" else 1
    p = np.array([*friction[:own], *contact[:own], 0.5, -0.25, 2.0])
    made = with_parameters(first, p)
    again = load_text(dumps(made))
    for found in (made, again):
        assert found.friction.tolist() == friction
        assert found.contact.tolist() == contact
        assert [each.centre.tolist() for each in found.colliders] == [[0.5, -1.25, 2.0]] * 2
        assert found.spheres[0].centre.tolist() == [1.5, -0.25, 2.0]
        np.testing.assert_array_equal(parameters(found), p)
    written = json.loads(dumps(made))
    laws = [{"friction": friction[i], "stiffness": contact[i]} for i in (0, 1)]
    assert written["colliders"] == [FLOOR, {**RUBS, **laws[0]}, OBSTACLES[2], {**RUBS, **laws[1]}]
    assert written["colliderOffset"] == xyz((0.5, -0.25, 2.0))


@pytest.mark.parametrize("name", ["friction", "contact", "colliderOffset"])
def test_what_belongs_to_colliders_needs_one(name):
    cases = {"": [], ' but planes; "planes": ': [FLOOR], " but plain spheres; ": [OBSTACLES[2]]}
    for more, colliders in cases.items():
        asked = document(fit={name: "G"}, colliders=colliders)
        if "spheres" in more and name == "colliderOffset":
            assert load(asked).blocks[-1].name == "offset"
        else:
            assert problems(asked)[0].startswith(f"fit.{name}: there are no colliders{more}")


def test_the_drag_has_the_unit_and_the_bounds_of_its_law():
    laws = [cloth(3, 3, dragLaw=law, fit={"dragCoefficient": "G"}) for law in ("air", "editor")]
    small = cloth(3, 3, 0.01, dragLaw="air", fit={"dragCoefficient": "G"})  # where the editor's law needs more
    made = load(document(*laws, small))
    assert [block.kind.unit for block in made.blocks] == ["", "kg/(m^6 s)", ""]
    assert [end.tolist() for end in bounds(made)] == [[0, 0, 0], [100, 1e4, 100]]


def test_what_the_parameters_stand_for():
    first = load(full({"vertVel": "G", "springRestLength": "G"}))
    p = parameters(first)
    assert p[17:21].tolist() == [0, 0, 0, 1]  # at rest, the lengths at vertPos
    p[17:21] = 1, 2, 3, 1.5
    one = with_parameters(first, p).cloths[0]
    np.testing.assert_array_equal(one.rest, 1.5 * first.cloths[0].lengths)
    assert one.velocity[~one.fixed].tolist() == [[1, 2, 3]] * 7
    assert one.velocity[one.fixed].tolist() == [[0, 0, 0]] * 2  # as they were


def test_one_value_stands_for_the_mean_of_the_free_vertices_and_of_the_factors():
    velocity = np.arange(27.0).reshape(9, 3)
    fields = {"vertVel": [xyz(v) for v in velocity], "springRestLength": [2.0] * 16}
    made = load(full({"vertVel": "G", "springRestLength": "G"}, **fields))
    one, p = made.cloths[0], parameters(made)
    np.testing.assert_allclose(p[17:20], velocity[~one.fixed].mean(axis=0), rtol=1e-15)  # rounding
    np.testing.assert_allclose(p[20], (2.0 / one.lengths).mean(), rtol=1e-15)


def test_elements_are_values_of_what_is_fitted_and_empty_for_the_rest():
    made = load(full({"springRestLength": "G"}, whole=["gravity"]))
    p = parameters(made)
    values, change = elements(made, 0, p), changes(made, 0, p, p)
    sizes = [9, 16, 0, 0, 0, 16, 0, 0, 0, 3, *[0] * 5]
    assert [len(part) for part in values] == [len(part) for part in change] == sizes
    system = build(made, 0)
    for mine, its in zip(all_elements(with_elements(system, values))[2:], all_elements(system)[2:], strict=True):
        np.testing.assert_array_equal(mine, its)  # the factor is exactly 1
    assert [len(part) for part in elements(made, 1, p)] == [4, 5, *[0] * 7, 3, *[0] * 5]


def test_bounds_are_those_of_the_kinds():
    lower, upper = bounds(load(full()))
    assert lower.tolist() == [1e-4] * 17 + [0.0] * 2 + [-1e4] * 3 + [1e-4] * 20 + [-1e4] * 6
    assert set(upper) == {1e4}
    lower, upper = bounds(scene(cloth(2, 2, optimizationSettings="nF", springStiffness=[5e-324] + [1.0] * 4)))
    assert 0 < lower[0] < upper[0] < np.inf  # of values next to nothing
    assert of_factor(np.array([1.0, 4.0]), (0.5, 8.0)) == (0.5, 2.0)  # the least and the largest value at their ends


# Saving ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", [{}, {"indent": 2}, {"separators": (",", ":")}, {"indent": "\t"}])
def test_a_needed_field_is_added_behind_the_others_and_nothing_else_changes(layout):
    fields = {name: value for name, value in cloth(2, 2).items() if name not in ("damping", "dragCoefficient")}
    whole = {name: value for name, value in document(fields).items() if name != "windVel"}
    text = json.dumps(whole, **layout)
    made = load_text(text)
    one = made.cloths[0]
    new = made.with_values(
        [one.mass], [one.stiffness], damping=[0.25], velocity=[np.full((4, 3), 0.5)], wind=(1.0, 2.0, 3.0)
    )
    saved = dumps(new).decode()
    own, shared = (re.search(rf',(\s*)"{last}"', text).group(1) for last in ("optimizationSettings", "colliders"))
    colon = re.search(r'"delta"(: ?)', text).group(1)
    separators = (",", ":") if colon == ":" else (", ", ": ")
    velocity, wind = (
        json.dumps(value, separators=separators) for value in ([xyz((0.5, 0.5, 0.5))] * 4, xyz((1, 2, 3)))
    )
    added = f',{own}"damping"{colon}0.25,{own}"vertVel"{colon}{velocity}'
    expected = text.replace(f'"optimizationSettings"{colon}"nn"', f'"optimizationSettings"{colon}"nn"{added}')
    expected = expected.replace(f'"colliders"{colon}[]', f'"colliders"{colon}[],{shared}"windVel"{colon}{wind}')
    assert saved == expected
    assert json.loads(saved)["objects"][0]["damping"] == 0.25
    assert dumps(load_text(saved)).decode() == saved


def test_one_component_changes_and_the_others_keep_their_spelling():
    text = json.dumps(document(cloth(2, 1, springs=[0, 1], springStiffness=[1.0], triangles=[])))
    text = text.replace('"windVel": {"x": 0.0,', '"windVel": {"note": [1, "x"], "x": 0.00e0,').replace(
        '"damping": 0.1', '"damping": 1.0e-1, "vertVel": [{"z":0.30,"x":1E0,"y":2},{"y":5,"x":4,"z":6, "w": "x"}]'
    )
    made = load_text(text)
    one = made.cloths[0]
    velocity = one.velocity.copy()
    velocity[1, 0] = 7.5
    new = made.with_values([one.mass], [one.stiffness], velocity=[velocity], wind=(0.0, 0.0, 1.5))
    expected = text.replace('"x":4', '"x":7.5').replace('"z": 0.0}, "objects"', '"z": 1.5}, "objects"')
    assert dumps(new).decode() == expected


def test_a_value_back_at_its_default_stays_in_the_file_that_has_it():
    text = json.dumps(document(gravity=xyz((0, -9.81, 0)), windVel=xyz((1, 2, 3))))
    made = load_text(text)
    still = made.with_values([made.cloths[0].mass], [made.cloths[0].stiffness], wind=(0.0, 0.0, 0.0))
    assert json.loads(dumps(still)) == {**json.loads(text), "windVel": xyz((0, 0, 0))}


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"mass": [[1, 1, 1]]}, "objects[0].vertMass: an array of int64 of shape (3,) is not 2 numbers"),
        *[({"mass": [wrong]}, "objects[0].vertMass: an array of ") for wrong in (["a", "b"], [1j, 1], [[1], [1, 2]])],
        ({"mass": [[1, 0]]}, "objects[0].vertMass[1]: the mass 0.0 kg must be above 0"),
        ({"mass": [[1, np.nan]]}, "objects[0].vertMass[1]: NaN is not a finite number"),
        ({"stiffness": [[-1]]}, "objects[0].springStiffness[0]: the stiffness -1.0 N/m must be 0 or more"),
        ({"mass": [], "stiffness": []}, "objects: 0 arrays of masses and 0 of stiffnesses for 1 objects"),
        ({"velocity": [[1, 2]]}, "objects[0].vertVel: an array of int64 of shape (2,) is not 2 × 3 numbers"),
        ({"gravity": (1, np.nan, 0)}, "gravity[1]: NaN is not a finite number"),
        ({"drag": []}, "drag: 0 items for 1 objects"),
        ({"colour": [1]}, "there is no kind 'colour'; there are mass, stiffness"),
    ],
)
def test_new_values_are_checked(others, message):
    others = dict(others)
    made = scene(thing([(0, 0, 0), (1, 0, 0)], [(0, 1)]))
    with pytest.raises(InvalidScene, match=re.escape(message)):
        made.with_values(others.pop("mass", [[1, 1]]), others.pop("stiffness", [[1]]), **others)


# What cannot be fitted ------------------------------------------------------------------------------------------------


def test_fixed_vertices_and_their_springs_hide_velocities_and_rest_lengths():
    made = load(full({"vertVel": "L", "springRestLength": "L"}))
    one = made.cloths[0]
    assert unobservable(one, "velocity", 0).tolist() == one.fixed.tolist()
    velocity = next(block for block in made.blocks if block.name == "velocity")
    lost = np.flatnonzero(~identifiable(made)[velocity.part])
    assert lost.tolist() == [0, 1, 2, 6, 7, 8]  # three components of vertices 0 and 2
    held = load(full({"springRestLength": "L"}, vertIsFixed=[True, True] + [False] * 7))
    (rest,) = (block for block in held.blocks if block.name == "rest")
    assert np.flatnonzero(~identifiable(held)[rest.part]).tolist() == [0]  # joins 0 and 1


def test_the_rest_length_of_what_has_no_stiffness_is_hidden_unless_that_is_fitted():
    links = {"stiffness": [0.0, 5.0], "fit": {"springRestLength": "L"}}
    points = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    for settings, lost in (("nn", [True, False]), ("nL", [False, False])):
        made = scene(thing(points, [(0, 1), (1, 2)], optimizationSettings=settings, **links))
        assert unobservable(made.cloths[0], "rest", 0).tolist() == lost


def test_drag_and_wind_need_faces_with_free_vertices_and_the_wind_a_drag():
    fit = {"dragCoefficient": True}
    nothing, still = {"triangles": []}, {"dragCoefficient": 0.0}
    for fields, kept in (({}, True), (nothing, False), ({"vertIsFixed": [True] * 4}, False), (still, True)):
        assert identifiable(scene(cloth(2, 2, fit=fit, **fields), fit={"windVel": True})).tolist() == [kept] * 4
    assert not identifiable(scene(cloth(2, 2, **still), fit={"windVel": True})).any()


def test_nothing_of_a_cloth_that_is_fixed_or_unseen_can_be_fitted():
    held = cloth(2, 2, vertIsFixed=[True] * 4, fit=EVERY)
    assert not identifiable(scene(held, fit={"gravity": True, "windVel": True})).any()
    made = scene(cloth(2, 2, fit=EVERY, vertIsFixed=[True] + [False] * 3), fit={"gravity": True})
    assert not identifiable(made, {0: np.zeros(4, bool)}).any()
    assert identifiable(made, {0: np.ones(4, bool)}).all()


def test_a_fit_of_the_scene_simulates_the_cloths_that_feel_it():
    still, windy, held = cloth(2, 2, dragCoefficient=0.0), cloth(2, 2), cloth(2, 2, vertIsFixed=[True] * 4)
    assert fitted_cloths(scene(still, windy, held, fit={"windVel": True})) == [1]
    assert fitted_cloths(scene(still, windy, held, fit={"gravity": True})) == [0, 1]
    assert fitted_cloths(scene(still, fit={"windVel": True})) == [0]  # nothing feels it; there is something to show
    assert fitted_cloths(scene(still, windy)) == []
