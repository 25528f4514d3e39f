"""What cannot be asked for: one line that says why, the exit code, and no file made or changed."""

import re
import shlex
import sys

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, trial, write_scene

from clothfit.cli.program import run

pytestmark = pytest.mark.slow  # simulates to fill the folder

KEYS = "--keyframes keys.json"
DRAWING = ("simulate scene.json", "estimate scene.json", "evaluate scene.json fitted.json")
INPUT = "cannot write …: it is an input"

USAGE = [
    ("fold", "no such command 'fold' (see clothfit --help)"),
    ("simulate", "missing argument 'SCENE' (see clothfit simulate --help)"),
    ("evaluate scene.json", "missing argument 'FITTED' (see clothfit evaluate --help)"),
    ("control scene.json", "missing option '--keyframes'"),
    ("estimate scene.json --fast", "no such option '--fast'"),
    ("simulate scene.json b.json", "got unexpected extra argument (b.json)"),
    ("simulate scene.json --steps", "option '--steps' requires an argument"),
    ("target scene.json --quiet=3", "option '--quiet' does not take a value"),
    ("simulate scene.json --feedback", "--feedback goes with --forces only"),
    ("simulate scene.json --set", "option '--set' requires an argument"),
    ("simulate scene.json --set=", "--set: there is no ''"),
    ("estimate scene.json --set lose=huber", "--set: there is no 'lose'; did you mean loss? (see clothfit estimate"),
    ("estimate scene.json --set loss", "--set loss: write its value too, as in loss=…"),
    ("estimate scene.json --set target=t.npz", "--set target: this is an option of its own, --target"),
    # slips of the pen
    ("estimat scene.json", "no such command 'estimat'; did you mean estimate? (see clothfit --help)"),
    ("Evaluate scene.json", "no such command 'Evaluate'; did you mean evaluate? (see clothfit --help)"),
    ("simulate a.json --stpes 3", "no such option '--stpes'; did you mean --steps? (see clothfit simulate --help)"),
    ("estimate a.json --max-eval 3", "no such option '--max-eval'; did you mean --max-evaluations? (see clothfit "),
    ("--quite simulate a.json", "no such option '--quite'; did you mean --quiet? (see clothfit --help)"),
    # words of other programs
    ("fit scene.json", "no such command 'fit'; did you mean estimate? (see clothfit --help)"),
    ("simulate a.json --frames 9", "no such option '--frames'; did you mean --steps? (see clothfit simulate --help)"),
    ("simulate a.json --fps 9", "no such option '--fps' (see clothfit simulate --help)"),  # --up is not meant
    ("new plane --pin 0", "no such option '--pin'; did you mean --fix-vertices? (see clothfit new --help-all)"),
    ("simulate a.json -x", "no such option '-x' (see clothfit simulate --help)"),
    # options that do not go together
    ("evaluate scene.json --speed fitted.json", "--speed takes one scene; FITTED does not go with it"),
    ("evaluate scene.json --speed --target t.npz", "--speed takes one scene; --target does not go with it"),
    ("evaluate scene.json --speed --gif x.gif", "--speed takes one scene; --gif does not go with it"),
    ("evaluate scene.json fitted.json --error 0.1", "--error goes with --speed only"),
    ("estimate scene.json --fit-time", "--fit-time, --fit-placement and --fit-scale are for the motion of --target"),
    ("estimate scene.json --up z", "--scale, --up, … and --map describe the motion of --target; add that"),
    ("estimate scene.json --starts 2 --report page.html", "--report is for one fit of one scene; make the pages of"),
    ("estimate scene.json --target t.npz@scene.json --report page.html", "--report shows the first --target"),
    ("estimate - --end-with-input", "--end-with-input watches standard input, which cannot be the scene as well"),
    ("new", "missing argument 'plane|MESH'"),
    ("new --weld", "missing argument 'plane|MESH'"),
    *[(f"new plane {option}", f"{option.split()[0]} is for meshes from files; leave it out")
      for option in ("--scale 2", "--up z", "--handedness left", "--weld")],
    *[(f"new box.obj {option}", f"{option.split()[0]} is for planes; leave it out")
      for option in ("--size 2", "--divisions 0", "--upright")],
    ("new plane --fps 9 --delta 1", "--delta and --fps say the same; give one of them"),
    ("new plane --bending 0 --no-bending", "--bending and --no-bending say the same; give one of them"),
    # of several scenes
    ("estimate a.json b.json -o one.json", "-o one.json: 2 scenes need a folder, or a name with {stem}"),
    ("estimate a.json b.json -o -", "standard input and output (-) are for one scene, not for 2"),
    ("estimate a.json b.json -", "standard input and output (-) are for one scene, not for 3"),
    ("estimate a.json b.json --checkpoint c", "--checkpoint: 2 scenes need one each: put {stem} into the name"),
    ("estimate a.json b.json --cluster tcp://localhost:1 --resume", "--checkpoint and --resume are for fits on this"),
    ("estimate a.json b.json --cluster tcp://localhost:1 --jobs 2", "--jobs is for this machine"),
    *[(f"estimate scene.json {several} --{option}", "… is for one scene fitted from one start on this machine")
      for several in ("a.json", "--starts 2", "--cluster tcp://h:1")
      for option in ("plot=x.png", "gif=x.gif", "log=x.jsonl", "forces=t.npz")],
]

VALUES = [
    ("simulate scene.json --steps many", "invalid value for '--steps': 'many' is not a valid integer"),
    *[(f"{command} --steps {steps}", f"--steps must be at least 1; {steps} was given")
      for command, steps in (("simulate scene.json", 0), ("simulate scene.json", -3), ("target scene.json", 0),
                             ("evaluate scene.json fitted.json", 0), ("evaluate scene.json --speed", 0),
                             ("check scene.json", 0))],
    *[(f"{command} scene.json --tolerance {value}", f"--tolerance must be above 0 and below 1; {value} was given")
      for command, value in (("simulate", 0), ("simulate", 1), ("simulate", "nan"), ("estimate", 2))],
    ("simulate scene.json --scale -1 -o x.pc2", "--scale must be above 0 and finite"),
    ("convert t.npz y.pc2 --to-scale 0", "--to-scale must be above 0"),
    ("target scene.json --noise -1", "--noise must be at least 0 and finite; -1 m was given"),
    ("target scene.json --seed -1", "invalid value for '--seed'"),
    ("check scene.json --memory lots", "--memory: 'lots' is not a size"),
    ("estimate scene.json --memory 0", "--memory must be between 1 byte and 8 EiB; '0' was given"),
    ("check scene.json --memory 1kB", "--memory: 1 kB is too little"),
    ("evaluate scene.json --speed --error 0", "--error must be above 0 and finite; 0 was given"),
    # of a fit
    ("estimate scene.json --rmse -1", "--rmse must be at least 0; -1 m was given"),
    ("estimate scene.json --method gauss", "…; did you mean gauss-newton?"),
    ("estimate scene.json --loss Huber", "…; did you mean huber?"),
    ("estimate scene.json --objective edge", "…; did you mean edge-length?"),
    ("estimate scene.json --prior much", "--prior must be auto, none or a width in log parameters above 0; 'much' was"),
    ("estimate scene.json --objective speed", "--objective: there is no 'speed'; use position, velocity, edge-length,"),
    ("estimate scene.json --objective velocity=fast", "--objective: velocity=fast: the weight is not a number, as in"),
    ("estimate scene.json --objective velocity --objective velocity=2", "--objective: velocity is given twice"),
    ("estimate scene.json --loss cauchy", "--loss: there is no 'cauchy'; use linear, soft_l1, huber"),
    ("estimate scene.json --loss-scale 0.1", "--loss-scale: the linear loss has none; choose the loss soft_l1 or"),
    ("estimate scene.json --loss huber --loss-scale 0", "--loss-scale must be above 0 and finite; 0 m was given"),
    ("estimate scene.json --substeps 2", "--substeps: a target is needed"),
    ("estimate scene.json --model auto", "model auto: a target is needed"),
    ("estimate scene.json --target t.npz --frames a", "--frames: 'a' is not A:B"),
    ("estimate scene.json --loss huber --loss-scale 1e300", "--loss-scale must be within 1e-100 … 1e+100 m; "),
    ("estimate scene.json --target t.npz --frames 9:", "…has …, none of which is in --frames "),
    ("estimate scene.json --target t.npz --map map.csv", "--map: … has all vertices, in their order; leave it"),
    ("estimate scene.json --starts 1000000000", "--starts must be at most 10000; 1000000000 was given"),
    # of forces that lead
    (f"control sheet.json {KEYS} --most 0", "--most must be above 0"),
    (f"control sheet.json {KEYS} --smooth -1", "--smooth must be at least 0"),
    (f"control sheet.json {KEYS} --smooth 1e200", "--smooth must be at least 0 and at most 1e+06"),
    (f"control sheet.json {KEYS} --actuate 9", "--actuate: vertex 9 does not exist"),
    (f"control sheet.json {KEYS} --actuate 0", "--actuate 0: all of these vertices are fixed"),
    (f"control sheet.json {KEYS} --table f.txt", "--table must be a file .csv"),
    (f"control sheet.json {KEYS} --table -", "--table must be a file .csv"),
    (f"control sheet.json {KEYS} --report -", "--report must be a file"),
    ("simulate sheet.json --forces keys.json", "keys.json: cannot be read as forces"),
    # of a new scene
    *[(f"new plane --{given}", "") for given in (
        "size=2x", "size=1x2x3", "size=big", "size=0", "rotate=1,2", "'move=1;2;3'", "move=1,2,nan", "fix-box=0,0,0",
        "fix-box=0,0:0,0,0,0", "fix-vertices=1-", "divisions=100000", "fix-vertices=", "fix-vertices=a",
        "fix-vertices=144", "fix-side=left=far", "fix-side=top", "sphere=0,0,0", "sphere=0,0,0,0", "wind=5",
        "fit=xx", "fit=masses", "fit=n", "frames=1", "delta=0", "density=0", "divisions=-1", "tolerance=2",
        "stiffness=nan", "drag=wind", "drag=-1")],
    ("new plane --size 1x", "--size: '1x' is not understood; give it as in 2 or 2x1.5"),
    ("new plane --size 1,2", "--size: '1,2' is not understood; give it as in 2 or 2x1.5"),
    ("new plane --fix-vertices 5-2", "--fix-vertices: '5-2' is not understood; give it as in 0,11,20-30"),
    ("new plane --fix-side inner", "--fix-side: there is no 'inner'"),
    ("new plane --divisions 1000", "a plane of 1000 divisions would have 1004004 vertices; it may have at most"),
    *[(f"new plane --region {given}", f"…{told}") for given, told in (
        ("a", "'a' is not understood"), ("=top", "--region: '=top' is not understood"),
        ("a=", "'a=' is not understood"), ("a=middle", "region a: there is no 'middle'"),
        ("a=top", "region a: the mesh is flat along y"), ("a=0-144", "vertex 144 does not"),
        ("a=3-1", "--region: '3-1'"), ("a=0,0:1,1,1", "--region: '0,0'"),
        ("a=9,9,9:10,10,10", "region: 'a' has no vertices"), ("elsewhere=0", "cannot be a"))],
]

FILES = [
    # what is read
    ("simulate absent.json", "absent.json: there is no such file"),
    ("simulate .", "…Is a directory"),
    ("simulate wrong.json", "wrong.json: objects[0].vertMass[3]: the mass -1.0 kg must be above 0"),
    *[(f"{command} empty.json", "empty.json: the file is empty") for command in ("simulate", "target", "estimate")],
    ("new -", "a mesh is not read from standard input; name a file"),
    ("estimate scene.json --start absent.json", "absent.json: there is no such file"),
    ("estimate scene.json --target absent.npz", "absent.npz: there is no such file"),
    ("estimate scene.json --target absent.npz@t.json", "t.json: there is no such file"),
    ("estimate scene.json --target=", "…"),
    ("estimate scene.json --start=", "…"),
    ("estimate other.json --target t.npz", "t.npz: has 16 points, other.json has 12 vertices; …they span 0 …"),
    ("estimate scnee.json", "scnee.json: there is no such file; did you mean scene.json?"),
    ("convert scene.json out.pc2", "scene.json is a scene; for its motion: clothfit simulate SCENE -o MOTION"),
    ("evaluate scene.json other.json", "other.json: its objects have "),
    ("evaluate scene.json fitted.json --target scene.json", "scene.json is a scene; did you mean SCENE"),
    ("evaluate scene.json fitted.json --target= --steps 20", "…"),
    # standard input, once
    *[(line, "standard input (-) can be only one of the inputs")
      for line in ("evaluate - -", "evaluate scene.json - --target -", "validate - -", "check - --target -",
                   "estimate - --target -", "estimate - --start -")],
    # what is written over nothing that is read
    ("target scene.json -o scene.json", INPUT),
    ("simulate scene.json -o moved.ply", "cannot write …: … can only be read"),
    ("simulate scene.json -o a.npz --up z", "….npz has the scene's axes and metres; leave --scale, --up, …out"),
    ("export scene.json --to csv -o -", "an export is several files, which need a folder; name one with -o"),
    ("simulate scene.json -o ''", "cannot write : it does not name a file"),
    *[(f"simulate scene.json -o {place}", f"cannot write {place}: {reason}") for place, reason in (
        ("folder", "it is a folder"), ("absent/x.npz", "the folder … does not exist"),
        ("scene.json", "it is an input, which is never written over; name another file"),
        ("./folder/../scene.json", "it is an input"), ("link.txt", "it is an input"), ("hard.txt", "it is an input"))],
    *[(f"simulate scene.json --dump {place}", told) for place, told in (
        ("-", "--dump must be a file of its own"), ("scene.motion.npz", "…another output"),
        ("./scene.motion.npz", "…another output"), ("scene.json", "…it is an input"),
        ("absent/x.npz", "…does not exist"))],
    *[(f"simulate scene.json -o '{name}'", "") for name in ("a.obj", "nowhere/a_*.obj", "a_*_*.obj")],
    *[(f"estimate scene.json --target t.npz@a.json --start fitted.json -o {name}", INPUT)
      for name in ("scene.json", "t.npz", "a.json", "fitted.json")],
    ("estimate scene.json --target t.trc --map map.csv -o map.csv", INPUT),
    ("estimate - --in-place", "--in-place writes into the scene's file"),
    ("estimate scene.json --in-place -o x.json", "--in-place writes into the scene's file"),
    ("estimate a.json b.json ./a.json", "a.json and ./a.json would both be written to ./a.fitted.json; use {folder}"),
    ("estimate a.json b.json a.json --in-place", "a.json and a.json would both be written to a.json"),
    ("estimate a.json b.json a.fitted.json", "cannot write a.fitted.json: it is an input, which is never written over"),
    ("estimate a.json b.json -o {stem}.json", "cannot write a.json: it is an input, which is never written over"),
    ("estimate a.json b.json -o t.npz/x/", "cannot make the folder t.npz/x/: Not a directory"),
    ("estimate scene.json --log absent/fit.jsonl", "cannot write absent/fit.jsonl: the folder"),
    *[(f"estimate scene.json --log {name}", f"--log: {name}: must be a file of its own, not an input or an output")
      for name in ("scene.json", "-", "scene.fitted.json")],
    ("evaluate scene.json --speed --plot x.gif", "x.gif: a picture's name ends in .png, .svg or .pdf"),
    ("evaluate scene.json --speed --plot -", "-: a picture's name ends in"),
    ("evaluate scene.json --speed --plot absent/x.png", "cannot write absent/x.png: the folder"),
    ("evaluate scene.png --speed --plot scene.png", "cannot write scene.png: it is an input or another output"),
    *[(f"{command} {option}", message) for command in DRAWING for option, message in (
        ("--plot x.jpg", "x.jpg: a picture's name ends in .png, .svg or .pdf"),
        ("--gif x.png", "x.png: a picture's name ends in .gif"),
        ("--plot absent/x.png", "cannot write absent/x.png: the folder"),
        ("--plot scene.json", "cannot write scene.json: it is an input or another output"))],
    *[(f"control sheet.json {KEYS} {option}", f"…{told}") for option, told in (
        ("--forces keys.json", "it is an input"), ("--report keys.json", "it is an input"),
        ("--forces m.npz -o m.npz", "another output"), ("--velocity --save m.npz -o m.npz", "another output"))],
    *[(line, f"cannot write {message}") for line, message in (
        ("new plane -o a/x.usd", "a/x.usd: a scene is written; name it a/x.json"),
        ("estimate scene.json -o x.npz", "x.npz: a scene is written; name it x.json"),
        ("estimate scene.json --report x.pdf", "x.pdf: a page is written; name it x.html"),
        ("report scene.json fitted.json -o x.json", "x.json: a page is written; name it x.html"),
        (f"control sheet.json {KEYS} --report x.gif", "x.gif: a page is written; name it x.html"))],
    ("export scene.json --to csv -o t.npz", "cannot make the folder t.npz: it is a file; name a folder"),
    ("estimate scene.json --target @", "the name of a file is empty; name one"),
    ("new box.obj -o box.obj", INPUT),
    ("new shot_*.obj -o shot_2.obj", INPUT),
    *[(f"convert {line}", "…it is an input") for line in (
        "t.npz t.npz", "shot_*.obj shot_*.obj", "shot_1.obj shot_*.obj", "shot_1.obj shot_1.obj",
        "shot_1.obj a.obj --mesh a.obj", "t.trc map.csv --map map.csv")],
]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with files of all kinds, and what they hold."""
    folder = tmp_path_factory.mktemp("place")
    for name in ("scene.json", "a.json", "b.json", "a.fitted.json", "fitted.json", "scene.png"):
        write_scene(folder, even("nG", 5), name)
    write_scene(folder, even("nG", 5, nx=3), "other.json")
    write_scene(folder, trial("nG", 5, vertMass=[0.1] * 3 + [-1] + [0.1] * 12), "wrong.json")
    write_scene(folder, document(cloth(3, 2), optimizationIterations=12), "sheet.json")
    write_scene(folder, {"keys": [{"time": 0.2, "vertices": [4], "positions": [[1.0, 0.2, 1.0]]}]}, "keys.json")
    np.savez(folder / "t.npz", positions=np.zeros((5, 16, 3)), times=0.02 * np.arange(5))
    for name in ("box.obj", "shot_1.obj", "shot_2.obj", "a.obj"):
        (folder / name).write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n")
    (folder / "map.csv").write_text("marker,object,vertex\n")
    (folder / "t.trc").write_text("")
    (folder / "empty.json").write_text(" \n")
    (folder / "folder").mkdir()
    (folder / "link.txt").symlink_to("scene.json")
    (folder / "hard.txt").hardlink_to(folder / "scene.json")
    return folder, held(folder)


def held(folder):
    """What is in the files of a folder."""
    return {path.name: path.read_bytes() if path.is_file() else None for path in folder.iterdir()}


CASES = [*((line, 2, told) for line, told in USAGE), *((line, 3, told) for line, told in (*VALUES, *FILES))]


@pytest.mark.parametrize(("line", "code", "message"), CASES, ids=[line for line, *_ in CASES])
def test_what_cannot_be_is_one_line_and_no_file(place, monkeypatch, capsys, line, code, message):
    folder, before = place
    monkeypatch.chdir(folder)
    ended = run(shlex.split(line))
    out, err = capsys.readouterr()
    assert (ended, out, err.count("\n")) == (code, "", 1)
    assert len(err) < 300
    assert re.match(".*".join(map(re.escape, f"error: {message}".split("…"))), err)
    assert held(folder) == before


@pytest.mark.parametrize(("option", "module", "library"), [("--plot x.png", "matplotlib", "matplotlib"),
                                                           ("--gif x.gif", "PIL", "Pillow")])  # fmt: skip
@pytest.mark.parametrize("command", DRAWING)
def test_a_missing_library_is_named_before_anything_is_done(
    place, capsys, monkeypatch, command, option, module, library
):
    monkeypatch.chdir(place[0])
    monkeypatch.setitem(sys.modules, module, None)
    assert run([*command.split(), *option.split()]) == 3
    name = option.split()[1]
    line = f"error: {name}: a picture needs {library}; install it with: pip install 'clothfit[plot]'\n"
    assert capsys.readouterr() == ("", line)
    assert held(place[0]) == place[1]
