"""Refresh three.js in the package: `python scripts/update_three.py [VERSION]` (default: the newest). Needs npm.

From the release's own module the names that `clothfit/report/web/*.js` import are kept, bundled into one minified
module by esbuild (releases have no minified one of their own any more), with the licence and a note of both versions
beside it.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

WEB = Path(__file__).resolve().parents[1] / "clothfit" / "report" / "web"
PLACE = WEB / "three"
ESBUILD = "0.28.2"  # another writes other bytes


def imported() -> list[str]:
    """The names that the page's modules take from three.js."""
    found: set[str] = set()
    for path in WEB.glob("*.js"):
        for names in re.findall(r'import \{([^}]*)\} from "three"', path.read_text("utf-8")):
            found |= {name.strip() for name in names.split(",") if name.strip()}
    return sorted(found)


def npm(folder: Path, *arguments: str) -> str:
    """Run npm in a folder; returns what it prints."""
    return subprocess.run(["npm", *arguments], cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout


def bundle(folder: Path, version: str) -> str:
    """Put the module, its licence and its version in place; returns the version."""
    packed = json.loads(npm(folder, "pack", f"three@{version}", "--json"))
    (found,) = packed.values() if isinstance(packed, dict) else packed
    subprocess.run(["tar", "xzf", found["filename"]], cwd=folder, check=True)
    names = imported()
    (folder / "entry.js").write_text(f'export {{ {", ".join(names)} }} from "./package/build/three.module.js";\n')
    (folder / "package.json").write_text("{}")
    npm(folder, "install", "--no-save", "--silent", f"esbuild@{ESBUILD}")
    banner = f"--banner:js=// three.js {found['version']}, MIT, see LICENSE beside it in clothfit/report/web/three"
    made = folder / "three.module.min.js"
    options = ["--bundle", "--minify", "--format=esm", "--legal-comments=inline", f"--outfile={made}", banner]
    subprocess.run([folder / "node_modules" / ".bin" / "esbuild", "entry.js", *options], cwd=folder, check=True)
    PLACE.mkdir(exist_ok=True)
    shutil.copy(made, PLACE / made.name)
    shutil.copy(folder / "package" / "LICENSE", PLACE / "LICENSE")
    note = {"three": found["version"], "esbuild": ESBUILD, "names": names}
    (PLACE / "version.json").write_text(json.dumps(note, indent=1) + "\n")
    return str(found["version"])


def main() -> None:
    """Refresh it."""
    with tempfile.TemporaryDirectory() as folder:
        print(f"three.js {bundle(Path(folder), sys.argv[1] if len(sys.argv) > 1 else 'latest')} → {PLACE}")


if __name__ == "__main__":
    main()
