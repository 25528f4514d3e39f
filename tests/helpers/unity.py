"""The Unity package: its compilation against the stand-in for Unity's types, and the harness that uses it."""

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from helpers.paths import ROOT
from helpers.scenes import environment

PACKAGE = ROOT / "examples" / "unity" / "com.clothfit.unity"
TESTS = ROOT / "tests" / "unity"
LANGUAGE = "7"  # C# of Mono's compiler; Unity 2021.3 has 9
SECONDS = 300


def compiled(out: Path, sources: Iterable[Path], references: Iterable[object] = (), *, program: bool = False) -> Path:
    """Compile sources, and refuse warnings."""
    kind = "-target:exe" if program else "-target:library"
    libraries = [f"-r:{each}" for each in references]
    strict = [f"-langversion:{LANGUAGE}", "-warn:4", "-warnaserror"]
    call = ["mcs", *strict, kind, f"-out:{out}", *libraries, *map(str, sources)]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


class Harness:
    """The program that uses the package, and what it printed last."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __call__(self, *arguments: object, code: int = 0, **keywords: Any) -> list[str]:
        """Run it and return its lines."""
        call = ["mono", str(self.path), *map(str, arguments)]
        keywords |= {"env": environment(LC_ALL="C.UTF-8"), "encoding": "utf-8", "timeout": SECONDS}
        done = subprocess.run(call, capture_output=True, check=False, **keywords)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout.splitlines()

    def journey(self, what: str, scene: str, project: Path, code: int = 0) -> list[str]:
        """Run a journey through the menu in the folder of a project, with this checkout's program."""
        os.makedirs(project / "Assets", exist_ok=True)
        return self("journey", what, scene, project, sys.executable, code=code)


def built(folder: Path) -> Harness:
    """The harness, with the package and the stand-in, in a folder."""
    engine = compiled(folder / "UnityEngine.dll", sorted(TESTS.glob("standin/*.cs")), ["System.Numerics"])
    runtime = compiled(folder / "Clothfit.Runtime.dll", sorted(PACKAGE.glob("Runtime/**/*.cs")), [engine])
    editor = compiled(folder / "Clothfit.Editor.dll", sorted(PACKAGE.glob("Editor/**/*.cs")), [engine, runtime])
    compiled(folder / "Clothfit.Tests.dll", sorted(PACKAGE.glob("Tests/**/*.cs")), [engine, runtime, editor])
    sources = sorted(TESTS.glob("harness/*.cs"))
    return Harness(compiled(folder / "harness.exe", sources, [engine, runtime, editor], program=True))
