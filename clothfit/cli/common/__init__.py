"""What several commands share.

console (all that is said), help and usage (how commands are explained), shared (options and files), motions, sequences
and pictures (what is read and written), files, command_line (how a run is repeated), progress, stability_warnings.
To add something: it belongs here only if two commands need it.
"""
