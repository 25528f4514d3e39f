"""What a gradient keeps in memory, for `adjoints.py`: beside this program, one that keeps the matrix of every step.

That one is written down in SciPy from the equations of `approximate.py`, on which it is a check: each
matrix is kept as compressed sparse rows, and factorised when the sweep back comes to it. Run as a script, this is one
gradient in a process of its own: `python benchmarks/stored_matrices.py VERTICES STEPS exact|approximate|matrices OUT`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import clothfit
from clothfit.base import threads
from clothfit.base.arrays import Array
from clothfit.engine.forces import total
from clothfit.engine.rollout import Rollout
from clothfit.engine.solve import sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import zeros
from clothfit.meshes.mesh import object_document, plane
from clothfit.scene.scene import Scene
from open_loop import SWEEPS, Task

KINDS = {"exact": "states", "approximate": "states", "matrices": "states and matrices"}
"""The gradients and what they keep."""


def sheet(vertices: int) -> Scene:
    """A level cloth of N × N vertices over 7 m, held at one side."""
    mesh = plane(vertices - 2, 7.0)
    fixed = mesh.positions[:, 2] == mesh.positions[:, 2].max()
    cloth = object_document(mesh, fixed, density=0.1, stiffness=50.0, damping=0.1, drag=0.1, settings="nL")
    fields = {"integrationMethod": 2, "delta": 0.02, "tolerance": 1e-5}
    return clothfit.load({**fields, "objects": [cloth], "colliders": []})


def child(vertices: int, steps: int, kind: str, out: str) -> None:
    """Compute a gradient as one of the programs does, in a process of its own; print its bytes and seconds."""
    task = Task(sheet(vertices), steps)
    nothing = np.zeros((steps, *task.system.x0.shape))
    motion = task.simulated(nothing, 1e-10)
    assert motion is not None
    weight = np.zeros_like(motion.x)
    weight[task.keys] = 2.0 * task.missed(motion)
    began = time.process_time()
    if kind == "matrices":
        kept = stored(task, motion)
        size = sum(each.data.nbytes + each.indices.nbytes + each.indptr.nbytes for each in kept)
        found = swept(task, motion, kept, weight)
    else:
        size = motion.x.nbytes + motion.w.nbytes
        found = SWEEPS[kind].gradient(task.system, motion, weight, 1e-10, ("force",)).force[:steps]
    spent = time.process_time() - began
    np.save(out, found)
    print(json.dumps({"bytes": size, "seconds": spent}))


def stored(task: Task, motion: Rollout) -> list[Any]:
    """The matrix of every step, as compressed sparse rows (SciPy)."""
    work, found = implicit.workspace(task.system), []
    for t in range(task.steps):
        implicit.assemble(task.system, motion.x[t], motion.velocity(t), False, work.A, work.nothing)
        found.append(sparse.to_scipy(*work.A).tocsr())
    return found


def swept(task: Task, motion: Rollout, kept: list[Any], weight: Array, whole: bool = False) -> Array:
    """The approximate gradient (T, n, 3) by the stored matrices: written down from the equations, in SciPy. `whole`
    takes all of ∂f/∂x where x̄ is found, also what the solver's K leaves out.
    """
    from scipy.sparse.linalg import splu

    h, free, mass = task.h, task.free, task.system.vertex.mass[:, None]
    x_bar, v_bar, found = np.zeros_like(task.system.x0), np.zeros_like(task.system.x0), np.zeros_like(motion.x[1:])
    for t in reversed(range(task.steps)):
        x_bar += weight[t + 1]
        lam, product = np.zeros_like(x_bar), np.zeros_like(x_bar)
        lam[free] = splu(kept[t].tocsc()).solve((v_bar + h * x_bar)[free].reshape(-1)).reshape(-1, 3)
        product[free] = (kept[t] @ lam[free].reshape(-1)).reshape(-1, 3)
        more, unused, v = np.zeros_like(x_bar), np.zeros_like(x_bar), motion.velocity(t)
        if whole:
            nothing = zeros(task.system)
            total.add_pullback(task.system, motion.x[t], v, v, np.zeros_like(v), lam, h, nothing, more, unused)
        else:
            total.add_damping(task.system, motion.x[t], v, h, lam, more)
            more = (mass * lam - more - product) / h  # h K λ
        x_bar += more
        v_bar, found[t] = mass * lam, h * lam
    return found


def memory(sizes: list[int], steps: int) -> None:
    """Print what a gradient keeps."""
    print("| vertices | gradient | keeps | MB | peak, MB | seconds |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for vertices in sizes:
            for kind, keeps in KINDS.items():
                run(vertices, 4, kind, str(Path(folder) / "first.npy"))  # compiles
                said, peak = run(vertices, steps, kind, str(Path(folder) / f"{kind}.npy"))
                name = "approximate, by SciPy" if kind == "matrices" else kind
                size = f"{said['bytes'] / 1e6:.1f}"
                print(f"| {vertices}² | {name} | {keeps} | {size} | {peak:.0f} | {said['seconds']:.2f} |", flush=True)
            own, other = (np.load(Path(folder) / f"{kind}.npy") for kind in ("approximate", "matrices"))
            print(f"the two approximate ones differ by {np.linalg.norm(own - other) / np.linalg.norm(other):.0e}")


def run(vertices: int, steps: int, kind: str, out: str) -> tuple[dict[str, float], float]:
    """What a child printed, and its peak of resident memory, MB."""
    command = [sys.executable, __file__, str(vertices), str(steps), kind, out]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        text = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return json.loads(text.splitlines()[-1]), used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6


if __name__ == "__main__":
    with threads.single():
        child(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
