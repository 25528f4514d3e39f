"""`clothfit warmup`: after it no command compiles anything."""

import json
import subprocess
import sys

import numba
import pytest
from helpers.scenes import cloth, environment, sphere, started, trial, write_scene

import clothfit
from clothfit.engine.solve import cg_multigrid, sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import build
from clothfit.kernels import cache as kernel_cache
from clothfit.kernels.cache import KernelCache
from clothfit.many.warmup import NEVER, PARTS, Part, called, strip_scene, use_everything, warm_up

pytestmark = pytest.mark.slow

# Runs warmup, then commands, and prints what of the compiled code was asked for after warmup for the first time. As it
# makes no difference whether that is already on the disk, nothing need be compiled for this test.
AFTERWARDS = """
import json, sys
from clothfit.kernels.cache import KernelCache
from clothfit.many.warmup import SMALL_PARTS, used
from clothfit.cli.program import run
for part in SMALL_PARTS:  # in this process
    used(part)
asked, load = [], KernelCache.load_overload
def note(self, sig, context):
    asked.append(f"{self._py_func.__module__}.{self._name} {sig}")
    return load(self, sig, context)
KernelCache.load_overload = note
codes = [run(line.split()) for line in sys.stdin.read().splitlines()]
json.dump([asked, codes], sys.stdout)
"""

KINDS = {"damping": "G", "dragCoefficient": "G", "vertVel": "G", "springRestLength": "G"}
WIND = {"windVel": {"x": 1.0, "y": 0.0, "z": 0.5}, "colliders": [sphere(0.3)]}
SCENES = {
    "all": trial("LL", 6, 3, 3, **WIND),
    "one": trial("nG", 6, 3, 3),
    "newton": trial("LL", 6, 3, 3, forwardSubSteps=3, **WIND),
    "explicit": trial("LL", 6, 3, 3, integrationMethod=0, delta=0.001),
    "symplectic": trial("GL", 6, 3, 3, integrationMethod=1, delta=0.001, **WIND),
    "two": {**trial("LL", 6, 3, 3), "objects": [cloth(3, 3, optimizationSettings=s) for s in ("LL", "nG")]},
    "kinds": {**trial("nn", 6), "fit": {"windVel": True, "gravity": True}, "objects": [cloth(3, 3, fit=KINDS)]},
    "beyond": {**trial("nG", 6), "tolerance": 1e-12, "objects": [
        cloth(9, 9, optimizationSettings="nG", springStiffness=[10 ** (0.618 * i % 1 * 11 - 4) for i in range(208)])]},
    "compressed": {**trial("nL", 6), "objects": [cloth(3, 3, optimizationSettings="nL", springRestLength=[3.0] * 16)]},
}
COMMANDS = [
    *(f"simulate -q {name}.json --energy" for name in SCENES),
    *(f"estimate -q {name}.json --max-evaluations 4" for name in SCENES),
    *(f"estimate -q {name}.json --max-evaluations 3 --method {method} --start 0.5 -o x.json"
      for name in ("all", "newton", "symplectic") for method in ("gauss-newton", "l-bfgs-b", "momentum")),
    "target -q all.json --noise 0.001 --observed 0.5 --every 2 -o some.npz",
    "target -q all.json --noise 0.001 --fps 35 -o fps.npz",
    "estimate -q all.json --target some.npz --max-evaluations 4 --holdout 0.2 -o x.json",
    "estimate -q all.json --target fps.npz --target some.npz --max-evaluations 3 --loss huber -o x.json",
    "estimate -q all.json --target fps.npz --max-evaluations 3 --objective velocity --objective spectrum -o x.json",
    "evaluate -q all.json x.json --steps 7 --gif x.gif",
    "check -q all.json",
    "info -q all.json",
    "new plane -q --integrator symplectic",
    "validate -q all.json",
    "evaluate -q all.json x.json --steps 7",
    "evaluate -q two.json two.fitted.json --target two.motion.npz --steps 7",
]  # fmt: skip


def test_after_it_no_command_asks_for_other_code(tmp_path):
    for name, scene in SCENES.items():
        write_scene(tmp_path, scene, f"{name}.json")
    call = [sys.executable, "-c", AFTERWARDS]
    done = subprocess.run(
        call, input="\n".join(COMMANDS), capture_output=True, text=True, env=environment(), cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stderr
    asked, codes = json.loads(done.stdout)
    assert asked == []
    assert set(codes) <= {0, 5}, done.stderr  # so few evaluations end a fit early


def test_the_command_says_what_it_did_and_where_and_does_nothing_twice():
    runs = [started("warmup", "--json", timeout=600) for _ in range(2)]
    first, second = (json.loads(run.stdout) for run in runs)
    assert [run.returncode for run in runs] == [0, 0]
    assert [part["name"] for part in second["parts"]] == list(PARTS)
    assert second["compiled"] == sum(part["compiled"] for part in second["parts"]) == 0
    assert first["folder"] == second["folder"]
    assert runs[1].stderr.decode() == f"everything is compiled, kept in {second['folder']}\n"


def test_where_it_cannot_keep_anything_it_fails(tmp_path):
    """What little it compiles comes from a scene of its own: the real ones take half a minute."""
    code = (
        "import clothfit.many.warmup as w, clothfit.kernels.cache as k, numba, sys; from pathlib import Path;"
        "k.folders = lambda: (Path(sys.argv[1]) / 'kernels-now',);"
        "f = numba.njit(lambda x: x); f._cache = k.KernelCache(f.py_func);"
        "w.PARTS = w.SMALL_PARTS = {'one': lambda: f(1)};"
        "from clothfit.cli.program import run; sys.exit(run(['warmup', '--small']))"
    )
    (tmp_path / "file").write_text("")
    call = [sys.executable, "-c", code, str(tmp_path / "file")]
    done = subprocess.run(call, capture_output=True, text=True, env=environment(), check=False)
    compiling, *told, error = done.stderr.splitlines()
    assert done.returncode == 3
    assert compiling.startswith("compiling for this machine")
    assert any(line.startswith("warning: compiled code cannot be kept") for line in told)
    assert error.startswith("error: the compiled code could not be stored")


def test_of_those_scenes_one_is_solved_directly_and_one_has_clamped_steps():
    """Else the ways there would not be tested above; and in that of the warm-up acts all that can."""
    beyond, compressed = (clothfit.simulate(clothfit.load(SCENES[name])).remedies for name in ("beyond", "compressed"))
    assert (beyond.direct_solves > 0, compressed.clamped_steps > 0) == (True, True)
    scene = strip_scene()
    (own,) = scene.cloths
    assert all((scene.spheres, scene.wind.any(), own.drag > 0, own.triangles.size, (own.rest > 0).all()))


def test_without_compilation_there_is_nothing_to_do():
    done = started("warmup", env=environment(NUMBA_DISABLE_JIT="1"))
    assert (done.returncode, done.stdout) == (3, b"")
    assert done.stderr.startswith(b"error: NUMBA_DISABLE_JIT is set")


def test_parts_are_reported_as_they_are_done(monkeypatch):
    heard = []
    small = {"one": lambda: numba.njit(lambda x: x)(1), "two": lambda: None}
    for name in ("SMALL_PARTS", "PARTS"):
        monkeypatch.setattr(f"clothfit.many.warmup.{name}", small)
    parts = use_everything(heard.append, small=True)
    assert parts == heard
    assert [(part.name, part.compiled) for part in parts] == [("one", 1), ("two", 0)]
    assert all(isinstance(part, Part) for part in parts)


def test_a_strip_can_be_called_large():
    """For them other code is compiled; here only what a cloth is taken for is looked at."""
    found = []
    for large in (False, True):
        with called(large):
            found.append(implicit.workspace(build(strip_scene(), 0)).solver.large is not cg_multigrid.NONE)
    assert found == [False, True]
    assert sparse.MULTIGRID_FROM < NEVER  # as before


def test_a_note_counts_only_while_all_files_are_there(tmp_path, monkeypatch):
    folder = tmp_path / "kernels-now"
    monkeypatch.setattr(kernel_cache, "folders", lambda: (folder,))
    for name, value in (("failed", False), ("used", None), ("names", set())):
        monkeypatch.setattr(KernelCache, name, value)
    used = []

    def use():
        used.append(kernel_cache.save("code", b"compiled"))
        KernelCache.names.add("code")

    for name in ("SMALL_PARTS", "PARTS"):
        monkeypatch.setattr(f"clothfit.many.warmup.{name}", {"one": use})
    for _ in range(2):
        assert [part.name for part in warm_up(small=True)] == ["one"]
    assert len(used) == 1
    assert KernelCache.used == folder
    (folder / "code").write_bytes(b"damaged")
    warm_up(small=True)
    assert len(used) == 2
