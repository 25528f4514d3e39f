"""Loading and saving scenes: from everywhere, in every encoding, back without a changed byte; broken files refused."""

import codecs
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.paths import SIDE
from helpers.scenes import cloth, document, load_text, problems, sphere

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.scene import scene

TEXT = json.dumps(document(cloth(), cloth(2, 2), title="tést", colliders=[sphere()]), ensure_ascii=False)

ENCODINGS = {
    "utf-8": b"",
    "utf-8 with mark": codecs.BOM_UTF8,
    "utf-16-le": codecs.BOM_UTF16_LE,
    "utf-16-be": codecs.BOM_UTF16_BE,
    "utf-32-le": codecs.BOM_UTF32_LE,
    "utf-32-be": codecs.BOM_UTF32_BE,
}


def scaled(made, factor):
    return made.with_values([c.mass * factor for c in made.cloths], [c.stiffness * factor for c in made.cloths])


def test_the_fields_become_arrays():
    fields = cloth(2, 2, optimizationSettings="gL", dragCoefficient=0.3, damping=2)
    made = scene.load(
        document(fields, windVel={"x": 1, "y": 2.5, "z": -3}, colliders=[sphere(0.75)], forwardSubSteps=3)
    )
    (only,) = made.cloths
    assert only.positions.tolist() == [[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]]
    assert only.fixed.tolist() == [True, True, False, False]
    assert only.springs.tolist() == [[0, 1], [0, 2], [0, 3], [1, 3], [2, 3]]
    assert only.triangles.tolist() == [[0, 2, 3], [0, 3, 1]]
    assert (only.mass.tolist(), only.stiffness.tolist()) == (fields["vertMass"], fields["springStiffness"])
    assert (only.drag, only.damping, only.settings) == (0.3, 2.0, "GL")
    dtypes = [array.dtype.name for array in (only.positions, only.fixed, only.springs, only.stiffness)]
    assert dtypes == ["float64", "bool", "int32", "float64"]
    assert (made.method, made.delta, made.tolerance, made.frames, made.newton_iterations) == (2, 0.02, 1e-5, 100, 3)
    assert made.wind.tolist() == [1, 2.5, -3]
    assert [(ball.centre.tolist(), ball.radius) for ball in made.spheres] == [([0, 0, 0], 0.75)]


def test_arrays_are_read_only_and_copies_of_what_is_given():
    made = scene.load(document(colliders=[sphere()]))
    arrays = [made.wind, made.spheres[0].centre, made.cloths[0].mass, scaled(made, 2).cloths[0].stiffness]
    assert not any(array.flags.writeable for array in arrays)
    given = np.array(made.cloths[0].mass)
    other = made.with_values([given], [made.cloths[0].stiffness])
    given[:] = 5.0
    assert other.cloths[0].mass.tolist() == made.cloths[0].mass.tolist()


def test_a_scene_comes_from_a_path_a_file_or_a_dict_and_has_a_name(tmp_path):
    path = tmp_path / "scene.txt"
    path.write_text(TEXT, encoding="utf-8")
    with path.open("rb") as binary, path.open(encoding="utf-8") as text:
        origins = [path, str(path), binary, text, io.BytesIO(TEXT.encode()), io.StringIO(TEXT), json.loads(TEXT)]
        made = [scene.load(origin) for origin in origins]
    assert [item.name for item in made] == ["scene.txt"] * 4 + ["scene"] * 3
    assert all(item.title == "tést" for item in made)
    given = io.BytesIO(TEXT.encode())
    given.name = "<stdin>"
    assert scene.load(given).name == "standard input"


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_every_encoding_comes_back_as_it_was(tmp_path, encoding, newline):
    codec = encoding.split()[0]
    text = json.dumps(json.loads(TEXT), indent=1, ensure_ascii=False).replace("\n", newline)
    data = ENCODINGS[encoding] + text.encode(codec)
    path = tmp_path / "scene.txt"
    path.write_bytes(data)
    made = scene.load(path)
    binary, characters = io.BytesIO(), io.StringIO()
    for place in (tmp_path / "same.txt", binary, characters):
        scene.save(made, place)
    assert (tmp_path / "same.txt").read_bytes() == binary.getvalue() == data
    assert characters.getvalue() == text
    first = scaled(made, 2).cloths[0].mass.tolist()
    assert load_text(scene.dumps(scaled(made, 2))).cloths[0].mass.tolist() == first


@pytest.mark.parametrize(
    ("old", "asked", "new"),
    [
        ('"delta": 0.02,', {"delta": 0.02 / 3}, '"delta": 0.006666666666666667,'),
        ('"delta": 2.0e-2,', {"delta": 0.02}, '"delta": 2.0e-2,'),
        ('"integrationMethod": 2,', {"method": "symplectic"}, '"integrationMethod": 1,'),
        ('"optimizationIterations": 100,', {"frames": 298}, '"optimizationIterations": 298,'),
    ],
)
def test_another_step_changes_these_numbers_and_no_other_byte(old, asked, new):
    text = TEXT.replace(old.replace("2.0e-2", "0.02"), old)
    assert text.count(old) == 1
    made = load_text(text)
    changed = made.with_step(**{"delta": made.delta, **asked})
    saved = scene.dumps(changed)
    assert saved.decode() == text.replace(old, new)
    again = load_text(saved)
    assert (again.method, again.delta, again.frames) == (changed.method, changed.delta, changed.frames)


def test_the_law_of_the_air_is_written_where_it_is_not_the_editors():
    made = load_text(TEXT)
    assert {each.drag_law for each in made.cloths} == {"editor"}
    other = replace(made, cloths=(replace(made.cloths[0], drag_law="air"), made.cloths[1]))
    saved = scene.dumps(other)
    assert saved.decode().replace(', "dragLaw": "air"', "") == TEXT
    again = load_text(saved)
    assert [each.drag_law for each in again.cloths] == ["air", "editor"]
    assert scene.dumps(again) == saved
    assert json.loads(scene.dumps(replace(again, cloths=made.cloths)))["objects"][0]["dragLaw"] == "editor"


def test_frames_that_the_text_lacks_are_added_where_they_are_not_the_default():
    text = TEXT.replace(' "optimizationIterations": 100,', "")
    made = load_text(text)
    assert scene.dumps(made.with_step(made.delta, 100)).decode() == text
    saved = scene.dumps(made.with_step(made.delta / 2, np.int64(199))).decode()
    assert saved == text.replace('"delta": 0.02,', '"delta": 0.01,')[:-1] + ', "optimizationIterations": 199}'


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"delta": 0.0}, "delta: 0.0 is too small"),
        ({"delta": 0.1, "method": "magic"}, "there is no integrator 'magic'; there are explicit, "),
    ],
)
def test_an_impossible_step_is_refused(asked, text):
    with pytest.raises(InvalidScene, match=text):
        load_text(TEXT).with_step(**asked)


def test_a_scene_changes_in_code_as_its_file_would():
    made = load_text(TEXT)
    asked = {"wind": (1, 0, 2), "gravity": (0, -3, 0), "frames": 7, "delta": 0.01, "integrator": "symplectic"}
    changed = made.changed(spheres=[(0, -1, 0, 0.5)], selfCollision={}, title="other", **asked)
    again = load_text(scene.dumps(changed))
    for each in (changed, again):
        assert (each.wind.tolist(), each.gravity.tolist()) == ([1, 0, 2], [0, -3, 0])
        assert (each.frames, each.delta, each.method, each.title) == (7, 0.01, 1, "other")
        assert [ball.radius for ball in each.spheres] == [*(ball.radius for ball in made.spheres), 0.5]
        assert each.self_contact is not None
    both = made.changed(changed)
    assert both.vertex_counts == 2 * made.vertex_counts
    assert len(both.spheres) == len(made.spheres) + len(changed.spheres)
    assert scene.dumps(made).decode() == TEXT


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"delta": -1.0}, "delta: -1.0 is too small"),
        ({"winds": (0, 0, 1)}, "there is no field 'winds'"),
        ({"wind": (0, 1)}, "wind: three numbers are needed"),
        ({"integrator": "magic"}, 'integrationMethod: "magic" is not a whole number'),
    ],
)
def test_an_impossible_change_is_refused(asked, text):
    with pytest.raises(InvalidScene, match=text):
        load_text(TEXT).changed(**asked)


# Text, beginning of the message, a word of it.
BROKEN = {
    "empty": ("", "the file is empty", "JSON object"),
    "not JSON": ("vertices: 3", "line 1, column 1: ", "not JSON"),
    "bracket": ('{"delta": 1,\n "objects": [}', "line 2, column 14: ", "not JSON"),
    "comma": ('{"delta": 1 "title": ""}', "line 1, column 13: ", "delimiter"),
    "truncated": (TEXT[:200], "line 1, column ", "is the file complete?"),
    "truncated string": ('{"tit', "line 1, column 2: ", "is the file complete?"),
    "latin-1": (TEXT.encode("latin-1"), "byte 13 (0xe9)", "not UTF-8 text"),
    "utf-16 cut": (codecs.BOM_UTF16_LE + TEXT.encode("utf-16-le")[:-1], "byte ", "not UTF-16"),
    "utf-16 without a mark": ("{}".encode("utf-16-le"), "line 1, column ", "UTF-16 without a byte order mark"),
    "nesting": ("[" * 100_000, "the JSON is nested too deeply", "deeply"),
    "repeated key": (TEXT.replace('"delta"', '"title": "b", "delta"'), "title: ", "more than once"),
    "repeated in object": (TEXT.replace('"springs"', '"springs": [], "springs"'), "objects[0].springs: ", "more than"),
    "repeated in unknown": (TEXT.replace("{", '{"u": [{"a b": 1, "a b": 2}], ', 1), 'u[0]."a b": ', "more than once"),
    "repeated twice": ('{"a": {"b": 1, "b": 2}, "a": 3}', "b: ", "more than once"),
    "NaN": (TEXT.replace("0.01,", "NaN,", 1), "objects[0].vertMass[0]: ", "NaN is not a finite number"),
    "-Infinity": (TEXT.replace("0.02", "-Infinity", 1), "delta: ", "-Infinity is not a finite number"),
    "1e999": (TEXT.replace("0.01,", "1e999,", 1), "objects[0].vertMass[0]: ", "finite number"),
    "digits": (TEXT.replace("0.01,", "9" * 5000 + ",", 1), "objects[0].vertMass[0]: ", "finite number"),
    "index of digits": (TEXT.replace("[0, 1", "[0, " + "9" * 5000, 1), "objects[0].springs[1]: ", "finite number"),
    "NaN unknown": ('{"u":"NaN",\n "v": NaN,' + TEXT[1:], "line 2, column 7: ", "NaN is not JSON"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_text_is_refused_with_the_place(kind):
    text, start, word = BROKEN[kind]
    found = problems(text)
    assert found[0].startswith(start)
    assert word in found[0]
    assert len(found[0]) < 200


def test_what_is_no_scene_at_all_is_refused(tmp_path):
    (tmp_path / "bad.txt").write_text(json.dumps(document(delta=0, tolerance=2)), encoding="utf-8")
    for path, message in (
        (tmp_path / "absent.txt", "absent.txt: there is no such file"),
        (tmp_path, f"{tmp_path.name}: cannot be read: Is a directory"),
        (tmp_path / "bad.txt", "bad.txt: delta: 0 is too small; it must be above 0 (and 1 more problem)"),
    ):
        with pytest.raises(InvalidScene) as caught:
            scene.load(path)
        assert str(caught.value) == message
    with pytest.raises(InvalidInput, match=r"cannot write .*absent does not exist"):
        scene.save(scene.load(document()), tmp_path / "absent" / "scene.txt")
    closed = io.StringIO("{}")
    closed.close()
    circle: dict[str, object] = {}
    circle["self"] = circle
    wide = io.TextIOWrapper(io.BytesIO(b"\xe9"), encoding="utf-8")
    with (tmp_path / "write-only.txt").open("w", encoding="utf-8") as unreadable:
        origins = [42, None, b"{}", closed, circle, {"delta": {1}}, {"delta": 10**5000}, "a\0b", "", wide, unreadable]
        for origin in [*origins, io.StringIO("\ud800")]:
            with pytest.raises(InvalidScene):
                scene.load(origin)


def test_unknown_fields_of_any_kind_are_no_error():
    strange = {"x": None, "y": [1e308, "\ud800", {"deep": [[]]}], "objects": 3, "": {}}
    ball = {**sphere(), "strange": strange}
    fields = document({**cloth(), "strange": strange}, strange=strange, colliders=[ball], title="a\ud800")
    fields["objects"][0]["vertPos"][1]["w"] = "up"
    text = json.dumps(fields).replace("1e+308", "9" * 5000)
    assert scene.dumps(load_text(text)).decode() == text
    assert load_text(text).title == "a?"  # half a surrogate cannot be printed


@pytest.mark.skipif(not SIDE.is_file(), reason="the real export ../shared/scenes/side.txt is not there")
def test_a_real_export_loads_and_comes_back_unchanged():
    made = scene.load(SIDE)
    assert made.name == "side.txt"
    assert [(len(c.mass), len(c.springs), len(c.triangles), c.settings) for c in made.cloths] == [
        (144, 726, 242, "nL"),
        (144, 726, 242, "nn"),
    ]
    assert (made.title, made.method, made.delta, made.frames) == ("side", 2, 0.019999999552965165, 100)
    assert scene.dumps(made) == SIDE.read_bytes()
    doubled = scaled(made, 2)
    assert load_text(scene.dumps(doubled)).cloths[1].stiffness.tolist() == doubled.cloths[1].stiffness.tolist()
