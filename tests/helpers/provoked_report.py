"""What provokes the errors of reports."""

from __future__ import annotations

from helpers.provoked import HARD, Case

COMMANDS: dict[str, Case] = {
    "the log cannot be read: …": Case("report scene.json scene.json --log missing.jsonl"),
    "no line of it tells how a fit went; give a file that estimate --log has written": Case(
        "report scene.json scene.json --log fit.jsonl", {"fit.jsonl": b"no\nlog\n"}
    ),
    "--report is for one fit of one scene; make the pages of several with clothfit report": Case(
        "estimate scene.json --starts 2 --report page.html"
    ),
    "--report must be a file of its own, not -; clothfit report writes to standard output": Case(
        "estimate scene.json --report -"
    ),
    "--report shows the first --target, which must be of SCENE itself, without @": Case(
        "estimate scene.json --target good.npz@scene.json --report page.html"
    ),
    "…; the frames before are shown": Case("report scene.json scene.json --steps 300", {"scene.json": HARD}),
}
