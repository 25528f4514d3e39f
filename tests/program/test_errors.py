"""Commands that fail: the exit code, the first words of the message, nothing on standard output, no file written over.

The cases are those that no test nearer to the code has, and a few of each exit code. A command runs in a folder with
`scene.json` (4 × 4 vertices, one mass to fit, 5 frames), `good.npz` (its motion) and its own files. In a message `…`
stands for what varies.
"""

import json
import re
import shlex
import struct
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import marker_files, scene_files
from helpers.paths import ROOT
from helpers.scenes import even, trial

from clothfit import InvalidInput, Reading, estimate, load, mesh, verify
from clothfit.cli.program import run
from clothfit.meshes.mesh import Mesh

VERTICES, SPRINGS = 16, 33
SMALL = trial("nG", 5)
POSITIONS = np.zeros((5, VERTICES, 3))
GOOD = {"positions": POSITIONS, "times": 0.02 * np.arange(5)}
HARD = even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1e3] * SPRINGS)  # explicit steps are too long
ZERO = {"x": 0, "y": 0, "z": 0}
GUSTY = trial("nG", 5, fit={"windVelKeys": "L"}, windVelKeys={"times": [0, 1], "values": [ZERO, {**ZERO, "x": 1}]})

TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"
FACES = "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n"
POINTS = "[(0, 0, 0), (1, 0, 0), (0, 1, 0)]"
TWO = [0.0, 1.0]


def fill(folder, files):
    """Write files: bytes, documents, or arrays of motions, by name."""
    for name, content in {"scene.json": SMALL, "good.npz": GOOD, **files}.items():
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        elif name.endswith(".npz"):
            np.savez(folder / name, **content)
        else:
            (folder / name).write_text(json.dumps(content), encoding="utf-8")


def pattern(message):
    """What matches a message with anything in its gaps."""
    return re.compile(".*".join(map(re.escape, message.split("…"))), re.DOTALL)


@pytest.fixture
def fails(tmp_path, monkeypatch, capsys):
    """Whether a command fails as it should."""

    def command(code, arguments, message, patches=(), **files):
        files = {name.replace("_", "."): content for name, content in files.items()}
        fill(tmp_path, files)
        before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        with monkeypatch.context() as patch:
            patch.chdir(tmp_path)
            patch.delenv("CLOTHFIT_TRACEBACK", raising=False)
            for name, value in patches:
                patch.setattr(name, value)
            ended = run(shlex.split(arguments))
        out, err = capsys.readouterr()
        last = err.splitlines()[-1]
        assert last.startswith("error: ")
        assert pattern(message).search(last)
        assert ended == code
        assert out == "" or arguments.split()[0] in ("check", "evaluate")  # a table may come before the error
        assert {name: (tmp_path / name).read_bytes() for name in before} == before

    return command


@pytest.mark.parametrize(
    ("arguments", "name", "value", "message"),
    [
        ("convert good.npz out.glb", "formats.glb.MOST_GLB_BYTES", 100, "are more than a GLB file can have;"),
        ("convert good.npz out.c3d", "formats.c3d.LARGEST_WORD", 1, " points are more than C3D can name; write"),
        ("simulate scene.json -o a.usd", "formats.registry.import_module", Mock(side_effect=ImportError),
         " needs …; install it with: pip install 'clothfit["),
    ],
)  # fmt: skip
def test_what_a_format_or_a_system_cannot_hold_ends_with_3(fails, arguments, name, value, message):
    fails(3, arguments, message, [(f"clothfit.{name}", value)])


def usd(*prims, head='#usda 1.0\n(upAxis = "Y"\nmetersPerUnit = 1)\n'):
    """A file with meshes, by what is in their braces."""
    return (head + "".join(f'def Mesh "m{i}"\n{{\n{prim}\n}}\n' for i, prim in enumerate(prims))).encode()


def samples(*each, codes=(1, 2)):
    """Points of a mesh over time."""
    inner = "".join(f"{code}: {points},\n" for code, points in zip(codes, each, strict=True))
    return f"point3f[] points.timeSamples = {{\n{inner}}}"


def glb(**changes):
    """Two triangles in a file with other parts."""
    return scene_files.whole(*scene_files.parts(), **changes)


def weights(values, count=4):
    """Two triangles with a target of so many vertices, and an animation of its weight."""
    return scene_files.moved("weights", TWO, values, targets=[np.zeros((count, 3))])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("npz", {"positions": np.zeros((2, 0, 3))}, "has no points"),
        ("pc2", struct.pack("<12siiffi", b"POINTCACHE2\0", 1, 1, 0, 1, 1), " bytes, it has …; is it complete?"),
        ("abc", b"\x89HDF", "it is in Alembic's older container, HDF5; convert it with: abcconvert -toOgawa"),
        ("abc", b"Ogawa\0" + bytes(20), "it was not written to its end; export it again"),
        ("stl", b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "it is cut off or damaged: …each needs 3;"),
        ("usda", usd(FACES + samples(POINTS, POINTS), FACES + samples(POINTS, POINTS, codes=(1, 3))),
         " have samples at different times; export one of them alone"),
        ("usda", usd(FACES + samples(POINTS, "[(0, 0, 0)]")), "its number of points changes over time; it must stay"),
        ("usda", usd(FACES), "it has no points"),
        ("usda", usd(samples(POINTS, POINTS) + "\nint[] faceVertexCounts = [3]\nint[] faceVertexIndices.timeSamples = "
                     "{\n1: [0, 1, 2],\n2: [0, 2, 1],\n}"), "its faces change over time; they must stay the same"),
        ("usda", usd(FACES + "point3f[] points = [(0, 0, 0)]"), "a triangle names a vertex beyond the … of its mesh"),
        ("usda", usd(FACES + f"point3f[] points = {POINTS}", head="#usda 1.0\n(metersPerUnit = 0)\n"),
         " cannot be; up is Y or Z, and the others are above 0"),
        ("glb", scene_files.container({}, version=1), "it is glTF version …; export version 2"),
        ("glb", glb(extensionsRequired=["KHR_draco_mesh_compression"]), "it needs the extension …, uncompressed"),
        ("glb", weights([1.0, 2.0, 3.0]), " values of an animation do not match … times"),
        ("glb", weights([1.0, 2.0, 3.0, 4.0]), " weights do not match the … targets of a mesh"),
        ("glb", weights(TWO, 3), "a target has … vertices, its mesh "),
        ("c3d", marker_files.c3d(np.zeros((1, 1, 3)), 83), " is not a type of processor that C3D knows (84, 85, 86)"),
        ("csv", b"time,a\n0,1\n", "column …, …, is not time, frame or a coordinate such as hem_x"),
    ],
)  # fmt: skip
@pytest.mark.slow  # the USD library reads in a process of its own
def test_a_file_that_cannot_be_read_ends_with_3(fails, name, content, message):
    if name == "usda":
        pytest.importorskip("pxr", reason="the USD library says what is wrong")
    fails(3, f"convert bad.{name} out.npz", message, **{f"bad_{name}": content})


@pytest.mark.parametrize(
    ("arguments", "message", "files"),
    [
        ("estimate scene.json --holdout 0.5", " frames, too few to keep some of them", {"scene_json": trial("nG", 2)}),
        ("estimate scene.json --holdout 0.5 --holdout-of vertices", "shows too few vertices to keep some of them out",
         {"scene_json": trial("nG", 5, vertIsFixed=[i > 0 for i in range(VERTICES)])}),
        ("estimate scene.json --target good.npz@other.json", " in this scene, … in …; a fit of both needs as many",
         {"scene_json": GUSTY, "other_json": trial("nG", 5)}),
        ("estimate scene.json --start other.json", " values of …, … are needed", {"other_json": trial("nG", 5, nx=3)}),
        ("estimate scene.json --target bad.csv", "no marker is seen in any frame",
         {"bad_csv": b"time,a_x,a_y,a_z,b_x,b_y,b_z\n0.02,,,,,,\n"}),
        ("convert good.npz a.pc2 --mesh a.obj", "--mesh: … has … vertices, the motion has ", {"a_obj": TRIANGLE}),
        ("report scene.json scene.json --log fit.jsonl", "no line of it is the record of a fit; give a file that",
         {"fit_jsonl": b"no\nlog\n"}),
    ],
)  # fmt: skip
@pytest.mark.slow  # compiles a simulation
def test_what_does_not_go_together_ends_with_3(fails, arguments, message, files):
    fails(3, arguments, message, **files)


@pytest.mark.parametrize(
    ("arguments", "message", "scene"),
    [
        ("evaluate scene.json scene.json --steps 300", "; the horizon ends before that",
         {**HARD, "optimizationIterations": 5}),
        ("report scene.json scene.json --steps 300", "; the frames before are shown", HARD),
        ("check scene.json --target far.npz", " diverged at step … (t = … s); try a smaller delta", HARD),
    ],
)  # fmt: skip
@pytest.mark.slow  # compiles a simulation
def test_what_diverges_ends_with_4(fails, arguments, message, scene):
    fails(4, arguments, message, scene_json=scene, far_npz={"positions": np.zeros((60, VERTICES, 3))})


@pytest.mark.parametrize(("gradient", "code", "message"), [
    (np.inf, 4, "the gradient overflows"),
    (1.0, 1, "the gradient is wrong (…): a fault of the program; please report it with the scene"),
])  # fmt: skip
@pytest.mark.slow  # compiles a fit
def test_a_gradient_that_is_wrong_ends_with_its_code(fails, gradient, code, message):
    pullback = "clothfit.objective.objective.Objective.add_pullback"
    fails(code, "check scene.json", message, [(pullback, lambda *arguments: arguments[-1].fill(gradient))])


def test_the_page_on_scripts_lists_the_exit_codes():
    text = (ROOT / "docs" / "many.md").read_text("utf-8")
    assert re.findall(r"^\| (\d+) \| ", text, re.MULTILINE) == ["0", "1", "2", "3", "4", "5", "130"]


SCENE, ONES = load(SMALL), np.ones(3)
LINE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([(0, 1, 1)], np.int32))


@pytest.mark.parametrize(
    ("message", "call"),
    [
        ("is not a number, an array of numbers or a scene", lambda: estimate(SCENE, start=["a"])),
        ("up must be y or z; 'x' was given", lambda: Reading(up="x")),
        ("a scene comes from a path, an open file or a dict, not from", lambda: load(5)),
        ("have no coefficient; give a number", lambda: mesh.air_drag(LINE, 1.0)),
        ("derivative check: only 0 of", lambda: verify.taylor_order(lambda p: 0.0, np.zeros(3), ONES, ONES)),
    ],
)
def test_a_call_from_python_raises_invalid_input(message, call):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        call()
