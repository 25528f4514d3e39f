"""What provokes the errors of `clothfit export`; see `provoked`."""

from helpers.provoked import Case

COMMANDS: dict[str, Case] = {
    "an export is several files, which need a folder; name one with -o": Case("export scene.json --to csv -o -"),
}
