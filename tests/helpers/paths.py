"""Where this repository is, and the shared pages beside it, which tests may read and must do without."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS, DOCS, EXAMPLES, TESTS = (ROOT / name for name in ("benchmarks", "docs", "examples", "tests"))
SHARED = ROOT.parent / "shared"
SIDE = SHARED / "scenes" / "side.txt"
