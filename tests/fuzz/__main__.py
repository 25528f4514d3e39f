"""Try hostile scenes, motions and checkpoints on the commands: in `tests`, python -m fuzz --seconds 60.

Cases come from a seeded generator, so that --seed S --count N are the same N cases again. Ends with exit code 1 when a
case led to anything but a documented exit code, a short message, 5 s and 1 GB of memory at most; the files that did are
kept in --keep FOLDER.
"""

import argparse
import faulthandler
import resource
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from fuzz.cases import Case, Verdict, case, tried, workplace

MOST_MEMORY = 1000  # MB
HUNG = 60  # s after which a case is given up, and with it the run
MOST_TOLD = 20
@dataclass
class Report:
    """What came of all cases."""

    keep: Path
    codes: Counter[int] = field(default_factory=Counter)
    kinds: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    longest: float = 0.0
    began: float = field(default_factory=time.perf_counter)

    @property
    def count(self) -> int:
        """Number of cases."""
        return sum(self.codes.values())

    def add(self, one: Case, verdict: Verdict) -> None:
        """Count a case; keep it where it has a fault."""
        self.codes[verdict.code] += 1
        self.kinds[f"{one.kind} {verdict.code}"] += 1
        self.longest = max(self.longest, verdict.seconds)
        for fault in verdict.faults:
            self.faults[fault] += 1
            if len(self.faults) <= MOST_TOLD and self.faults[fault] == 1:
                self.keep.mkdir(parents=True, exist_ok=True)
                (self.keep / f"{self.count}.{one.kind}").write_bytes(one.data)
                print(f"case {self.count} ({' '.join(one.arguments)}): {fault}", flush=True)

    @property
    def memory(self) -> float:
        """Peak of this process, MB."""
        size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return size / 1e6 if sys.platform == "darwin" else size / 1e3

    def finish(self) -> int:
        """Print the figures; returns the exit code."""
        seconds = time.perf_counter() - self.began
        codes = ", ".join(f"{code}: {count}" for code, count in sorted(self.codes.items()))
        kinds = ", ".join(f"{kind}: {count}" for kind, count in sorted(self.kinds.items()))
        print(f"{self.count} cases in {seconds:.0f} s; exit codes {codes} ({kinds})")
        print(f"longest {self.longest:.2f} s; peak memory {self.memory:.0f} MB; faults {sum(self.faults.values())}")
        for fault, count in self.faults.most_common(MOST_TOLD):
            print(f"{count} × {fault}")
        return int(bool(self.faults) or self.memory > MOST_MEMORY)


def generated(report: Report, seed: int, count: int | None, seconds: float, moving: bool = True) -> None:
    """Try cases of a seeded generator, so many or so long, also of what is `moving`; in a workplace."""
    end = time.perf_counter() + seconds
    number = 0
    while number < count if count is not None else time.perf_counter() < end:
        one = case(Random(f"{seed}-{number}"), moving)
        faulthandler.dump_traceback_later(HUNG, exit=True)
        report.add(one, tried(one))
        number += 1
    faulthandler.cancel_dump_traceback_later()


def main() -> int:
    """Parse, try, report."""
    parser = argparse.ArgumentParser("python -m fuzz", description=__doc__.split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="how long [default: 60]")
    parser.add_argument("--count", type=int, help="so many cases instead")
    parser.add_argument("--seed", type=int, default=0, help="of the generator [default: 0]")
    parser.add_argument("--keep", type=Path, default=Path("faults"), help="where what led to a fault goes")
    options = parser.parse_args()
    report = Report(options.keep.absolute())
    with tempfile.TemporaryDirectory() as folder, workplace(folder):
        generated(report, options.seed, options.count, options.seconds)
        return report.finish()


if __name__ == "__main__":
    sys.exit(main())
