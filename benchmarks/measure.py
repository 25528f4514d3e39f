"""What the benchmarks share: a fixed number of cores, runs in turn, and a line that says on what machine."""

from __future__ import annotations

import argparse
import itertools
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Work = Callable[[], object]
PEERS = {
    "cpp": "cpp_peer", "numba": "plain_numba", "scipy": "scipy_peer", "jax": "jax_peer", "torch": "torch_peer",
    "warp": "warp_peer",
}  # fmt: skip
"""The peers' files by the names of their libraries."""

PACKAGES = ("numpy", "scipy", "numba", "jax", "torch", "warp-lang")


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_cores(count: int) -> None:
    """Keep this process on `count` cores, where the system can; to be called before libraries count them."""
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["NUMBA_NUM_THREADS"] = str(count)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-count:])


def peer_classes(names: list[str]) -> dict[str, Any]:
    """The classes of those peers whose libraries are installed, by name; says of the others that they are not."""
    found = {}
    for name in names:
        try:
            found[name] = import_module(f"peers.{PEERS[name]}").Peer
        except ImportError as problem:
            print(f"{name}: left out, {problem}", file=sys.stderr)
    return found


CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
"""What `--clock` may be: the time that passes, or what this process uses, which others hardly change."""


def in_turn(works: Mapping[str, Work], rounds: int, clock: str = "wall") -> dict[str, NDArray[np.float64]]:
    """Seconds of each work in each round; first all run once for their compilation, then in turn, A B C, A B C.

    What slows the machine for a while slows them all, so ratios of one round can be trusted more than the seconds.
    """
    now = CLOCKS[clock]
    for work in works.values():
        work()
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            began = now()
            work()
            seconds[name].append(now() - began)
    return {name: np.array(each) for name, each in seconds.items()}


def fresh(p: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]]:
    """Values that are others each time, by a part in 10⁹: what is computed is never what is still at hand."""
    count = itertools.count(1)
    return lambda: (1.0 + 1e-9 * next(count)) * p


def add_options(parser: argparse.ArgumentParser, rounds: int, peers: list[str]) -> None:
    """The options that the scripts share."""
    parser.add_argument("--rounds", type=int, default=rounds, help=f"runs of each program (default: {rounds})")
    peers_help = f"default: {', '.join(peers)}, as far as installed"
    parser.add_argument("--peers", nargs="*", default=peers, choices=PEERS, help=peers_help)
    parser.add_argument("--cores", type=int, default=1, help="cores that each program may use (default: 1)")
    parser.add_argument("--clock", default="wall", choices=CLOCKS, help="cpu: on a busy machine, with one core")


def heading(given: argparse.Namespace) -> str:
    """The line above the tables: machine, versions, commit, rounds and clock."""
    clock = ", processor time" if given.clock == "cpu" else ""
    return f"{machine()}; medians of {given.rounds} rounds{clock}"


def machine() -> str:
    """Processor, versions and commit."""
    packages = []
    for name in PACKAGES:
        try:
            packages.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    count = cores()
    return (
        f"{processor()}, {'one core' if count == 1 else f'{count} cores'} of {os.cpu_count()}; {platform.system()}, "
        f"Python {platform.python_version()}, {', '.join(packages)}; clothfit {commit()}"
    )


def processor() -> str:
    """The processor's name, and its current frequency where Linux reports it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    facts = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    name = facts.get("model name", platform.machine())
    return f"{name} at {float(facts['cpu MHz']) / 1000:.2f} GHz" if "cpu MHz" in facts else name


def commit() -> str:
    """Version and, in a checkout, the commit, with a + where files differ from it."""
    import clothfit

    folder = Path(__file__).parent
    git = ["git", "-C", str(folder), "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        said = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return clothfit.__version__
    return f"{clothfit.__version__} at {said}"
