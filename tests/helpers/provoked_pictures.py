"""What provokes the errors of pictures and logs (see `provoked`)."""

from helpers.provoked import SMALL, Case

TRIAL = "estimate scene.json --target good.npz "

COMMANDS = {
    "… is for one scene fitted from one start on this machine": Case(TRIAL + "--starts 2 --log x.jsonl"),
    "cannot write …: it is an input or another output": Case("simulate x.gif --gif x.gif", {"x.gif": SMALL}),
    "--log: …: must be a file of its own, not an input or an output": Case(TRIAL + "--log good.npz"),
}
