"""Print how fast this program is on the machine at hand, beside C++ by hand: `python benchmarks/machine.py [--quick]`.

The tables of `speed.py`, for the processor as it is and, where it is of that kind, as one of 2013 (Haswell: AVX2, no
AVX-512), and those of `scaling.py` from 64² to 512² vertices, with the bytes that must move; then exact fits of one
value for each vertex and spring to motions of sheets of 40² to 60² vertices. Each runs in a process of its own.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def run(title: str, script: str, *options: str, **variables: str) -> None:
    """Print a title and what a script of this folder prints, with some variables of the environment set."""
    print(f"\n## {title}\n", flush=True)
    subprocess.run([sys.executable, HERE / script, *options], env=os.environ | variables, check=True)


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description="Print how fast this program is on this machine.")
    parser.add_argument("--quick", action="store_true", help="fewer rounds, grids up to 128²")
    quick = parser.parse_args().quick
    rounds = ("--rounds", "3" if quick else "25")
    sizes = ("64", "128") if quick else ("64", "128", "256", "512")
    small = ("--table", "programs", "--peers", "cpp", "numba", *rounds)
    run("Small cloths", "speed.py", *small)
    if platform.machine() in ("x86_64", "AMD64"):
        run("Small cloths, as on a Haswell", "speed.py", *small, NUMBA_CPU_NAME="haswell")
    run("Large cloths", "scaling.py", *sizes, "--peers", "cpp", "--rounds", "1" if quick else "3")
    run("Exact fits of sheets", "sheets.py", *(("30",) if quick else ("40", "50", "60")))


if __name__ == "__main__":
    main()
