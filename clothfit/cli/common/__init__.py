"""What several commands share.

console (messages and results), help (how commands explain themselves), output (what is written, and --json) → options
(those of all commands), failures (what is printed then) and scenes (what is read) → motions, pictures, progress. A
module belongs here only if two commands need it.
"""
