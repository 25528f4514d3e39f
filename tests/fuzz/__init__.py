"""Hostile input by the thousand: what nobody thought of, from what is valid. `python -m fuzz --help`, in `tests`."""
