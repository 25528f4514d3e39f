"""What several commands share.

console (messages and results), output (what is written, and --json) → options (how a command is declared and explains
itself) and scenes (what is read) → motions, pictures, progress; running (--watch,
--end-with-input). A module belongs here only if two commands need it.
"""
