"""What several commands share.

console (messages and results), output (what is written, and --json) → options (how a command is declared, explains
itself and is completed) and scenes (what is read) → motions, pictures, progress; running (--watch, --end-with-input).
To add an option: a line above the command, or a field of the dataclass that its options are gathered in.
"""
