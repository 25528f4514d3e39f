"""C++ by hand for vector registers (`cloth.cpp`), compiled for this machine, or for that of NUMBA_CPU_NAME."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from peers.problem import Problem

SOURCE = Path(__file__).with_name("cloth.cpp")
FAST = ["-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math", "-ffp-contract=fast"]
FLAGS = ["-O3", *FAST, "-std=c++17", "-Wno-psabi", "-Wno-ignored-attributes", "-shared", "-fPIC"]
"""Not -ffast-math: a library that is linked with it flushes small numbers to 0 in all of the process."""

LANES = 4  # springs come by so many; lanes that are left over are of a spring without stiffness from a fixed vertex


class Cloth(ctypes.Structure):
    """The structure of the same name in C++."""

    _fields_ = [
        *((name, ctypes.c_long) for name in ("n", "springs", "faces", "rows", "slots")),
        *((name, ctypes.c_void_p) for name in ("x0", "v0", "mass", "rest", "ends", "corners", "free")),
        *((name, ctypes.c_void_p) for name in ("order", "row", "column", "slot")),
        *((name, ctypes.c_double) for name in ("drag", "damping", "h")),
        *((name, ctypes.c_double * 4) for name in ("wind", "gravity")),
    ]


@cache
def library() -> Any:
    """The compiled program. Raises ImportError where there is no compiler of C++."""
    compiler = os.environ.get("CXX") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        raise ImportError("no compiler of C++")
    processor = os.environ.get("NUMBA_CPU_NAME", "native")
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "cloth.so"
        flags = (*FLAGS, f"-march={processor}")
        subprocess.run([compiler, *flags, str(SOURCE), "-o", str(built)], check=True)
        made: Any = ctypes.CDLL(str(built))
    made.simulate.restype, made.cost_and_gradient.restype = ctypes.c_long, ctypes.c_double
    return made


def quads(a):
    """(…, 3) as (…, 4), the last number 0."""
    wide = aligned(*a.shape[:-1], 4)
    wide[..., :3] = a
    return wide


def aligned(*shape):
    """Zeros that begin at a multiple of 64 bytes."""
    size = int(np.prod(shape))
    memory = np.zeros(size + 8)
    begin = (-memory.ctypes.data // 8) % 8
    return memory[begin : begin + size].reshape(shape)


class Peer:
    """The program on one cloth."""

    name = "C++"

    def __init__(self, problem: Problem) -> None:
        self.library, self.iterations = library(), 0.0
        ends, n, count = problem.ends.astype(np.int64), len(problem.mass), len(problem.stiffness)
        self.problem, self.padded = problem, -(-count // LANES) * LANES
        order = np.flatnonzero(problem.free)
        kept = problem.free[ends].all(axis=1)
        keys, inverse = np.unique(np.sort(ends[kept], axis=1) @ [n, 1], return_inverse=True)
        slot = np.full(self.padded, len(keys))
        slot[:count][kept] = inverse
        row = np.concatenate([np.searchsorted(keys, order * n), [len(keys)]])
        filled = np.concatenate([ends, np.tile(ends[:1], (self.padded - count, 1))])
        rest = aligned(self.padded)
        rest[:count] = problem.rest
        integers = {
            "ends": filled, "corners": problem.corners, "free": problem.free, "order": order, "row": row,
            "column": keys % n, "slot": slot,
        }  # fmt: skip
        self.arrays = {name: np.ascontiguousarray(each, np.int32) for name, each in integers.items()}
        self.arrays |= {"x0": quads(problem.x0), "v0": quads(problem.v0), "mass": problem.mass, "rest": rest}
        self.cloth = Cloth(
            n, self.padded, len(problem.corners), len(order), len(keys),
            **{name: each.ctypes.data for name, each in self.arrays.items()},
            drag=problem.drag, damping=problem.damping, h=problem.h,
            wind=(*problem.wind, 0.0), gravity=(*problem.gravity, 0.0),
        )  # fmt: skip
        self._target: tuple[Any, Any] = None, None

    def stiffnesses(self, k):
        """k with the lanes that are left over."""
        wide = np.zeros(self.padded)
        wide[: len(k)] = k
        return wide

    def steps(self, n, tolerance):
        """The motion of n steps."""
        xs, vs = aligned(n + 1, self.cloth.n, 4), aligned(n + 1, self.cloth.n, 4)
        k = self.stiffnesses(self.problem.stiffness)
        done = self.library.simulate(*addresses(self.cloth, k), n, ctypes.c_double(tolerance), *addresses(xs, vs))
        self.iterations = done / n
        return xs[:, :, :3]

    def cost_and_gradient(self, k, target, tolerance):
        """G and ∂G/∂k."""
        if self._target[0] is not target:
            self._target = target, quads(np.asarray(target))
        goal, gradient = self._target[1], np.zeros(self.padded)
        given = (len(target) - 1, ctypes.c_double(tolerance), *addresses(goal, gradient))
        cost = self.library.cost_and_gradient(*addresses(self.cloth, self.stiffnesses(k)), *given)
        return cost, gradient[: len(k)]


def addresses(*each):
    """Where a structure or arrays lie, as C++ takes them."""
    return [ctypes.byref(one) if isinstance(one, Cloth) else one.ctypes.data_as(ctypes.c_void_p) for one in each]
