"""`clothfit completion`: what a shell needs to complete commands, options and file names."""

from __future__ import annotations

import click

from clothfit.cli.common.console import Console
from clothfit.cli.common.options import standard_command
from clothfit.cli.common.output import print_json

SHELLS = ("bash", "zsh", "fish")


@standard_command("completion")
@click.argument("shell", type=click.Choice(SHELLS), metavar="bash|zsh|fish")
def command(shell: str, as_json: bool, console: Console) -> None:
    """Print the script with which a shell completes commands, options and file names.

    \b
    eval "$(clothfit completion bash)"  # put this line into ~/.bashrc
    eval "$(clothfit completion zsh)"   # into ~/.zshrc, after compinit
    clothfit completion fish > ~/.config/fish/completions/clothfit.fish

    Run or add the line of your shell once and open a new terminal. It needs bash 4.4 or newer. The script asks the
    installed program what it can complete.
    """
    text = script(shell)
    if as_json:
        print_json("completion", {"shell": shell, "script": text})
    else:
        click.echo(text, nl=False)


def script(shell: str) -> str:
    """The script for that shell."""
    from click.shell_completion import get_completion_class

    made = get_completion_class(shell)
    assert made is not None  # click knows all three
    root = click.get_current_context().find_root().command
    complete = made(root, {}, "clothfit", "_CLOTHFIT_COMPLETE")
    return complete.source_template % complete.source_vars()  # `source` asks bash for its version first
