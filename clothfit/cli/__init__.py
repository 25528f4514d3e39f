"""The command line: one file per command, and program, which knows them all.

Commands only parse, call, write and exit; the libraries load when a command runs. common/ has what several commands
share, parts/ the longer parts of single commands.
To add a command: a module here with a click command named `command`, and a line in `program.SUMMARIES`.
"""
