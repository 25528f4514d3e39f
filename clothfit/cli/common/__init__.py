"""What several commands share.

console (messages), help and usage (how commands explain themselves) → options (those of all commands) → output, scenes,
json_summary and signals (what is read and written) → motions, pictures, progress, stability_warnings; sequences and
command_line (what stands on the command line). A module belongs here only if two commands need it.
"""
