"""`clothfit completion`: what a shell needs to complete commands, options and file names."""

from __future__ import annotations

import click

from clothfit.cli.common.console import Console
from clothfit.cli.common.options import standard_command
from clothfit.cli.common.output import print_json

SHELLS = ("bash", "zsh", "fish")

BASH = r"""
_clothfit_completion() {
    local kind value text="${COMP_WORDS[*]:0:COMP_CWORD+1}" before=
    local -a words
    text=${text// = /=}  # bash takes NAME=VALUE apart
    text=${text/% =/=}
    read -ra words <<< "$text"
    [[ $text == *" " ]] && words+=("")
    [[ $COMP_WORDBREAKS == *=* && ${words[-1]} == *=* ]] && before=${words[-1]%%=*}=
    COMPREPLY=()
    while IFS=, read -r kind value; do
        COMPREPLY+=("${value#"$before"}")
        [[ $kind == path ]] && compopt -o filenames 2> /dev/null
        [[ $value == *= || $value == */ ]] && compopt -o nospace 2> /dev/null
    done < <(COMP_WORDS="$text" COMP_CWORD=$((${#words[@]} - 1)) _CLOTHFIT_COMPLETE=bash_complete "$1")
}
complete -o nosort -F _clothfit_completion clothfit
"""

ZSH = r"""#compdef clothfit

_clothfit_completion() {
    local -a alone described open files
    local kind value help
    while IFS= read -r kind && IFS= read -r value && IFS= read -r help; do
        if [[ $value == *[=/] ]]; then open+=("$value")
        elif [[ $kind == path ]]; then files+=("$value")
        elif [[ $help == _ ]]; then alone+=("$value")
        else described+=("${value//:/\\:}:$help")
        fi
    done < <(COMP_WORDS="${words[*]}" COMP_CWORD=$((CURRENT - 1)) _CLOTHFIT_COMPLETE=zsh_complete clothfit)
    (( $#described )) && _describe -V clothfit described -U
    (( $#alone )) && compadd -U -V values -- "${alone[@]}"
    (( $#open )) && compadd -U -S '' -V open -- "${open[@]}"
    (( $#files )) && compadd -U -f -V files -- "${files[@]}"
}

if [[ $zsh_eval_context[-1] == loadautofunc ]]; then
    _clothfit_completion "$@"
else
    compdef _clothfit_completion clothfit
fi
"""

FISH = r"""function _clothfit_completion
    set -l asked _CLOTHFIT_COMPLETE=fish_complete COMP_WORDS=(commandline -cp) COMP_CWORD=(commandline -t)
    for line in (env $asked clothfit)
        string replace -r '^[a-z]+,' '' -- $line
    end
end

complete --no-files --command clothfit --arguments "(_clothfit_completion)"
"""

SCRIPTS = {"bash": BASH.lstrip(), "zsh": ZSH, "fish": FISH}
"""What each shell is told. The program answers with lines of the kind of a completion, plain or path, and its text."""


@standard_command("completion")
@click.argument("shell", type=click.Choice(SHELLS), metavar="bash|zsh|fish")
def command(shell: str, console: Console) -> None:
    """Print the script with which a shell completes commands, options and file names.

    \b
    eval "$(clothfit completion bash)"  # put this line into ~/.bashrc
    eval "$(clothfit completion zsh)"   # into ~/.zshrc, after compinit
    clothfit completion fish > ~/.config/fish/completions/clothfit.fish

    Run or add the line of your shell once and open a new terminal. It needs bash 4.4 or newer. The script asks the
    installed program what it can complete.
    """
    if not print_json({"shell": shell, "script": SCRIPTS[shell]}):
        click.echo(SCRIPTS[shell], nl=False)

