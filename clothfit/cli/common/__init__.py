"""What several commands share.

console (messages), help (how commands explain themselves) → options (those of all commands) → output (what is written,
and --json) and scenes (what is read) → motions, pictures, progress. A module belongs here only if two commands need it.
"""
