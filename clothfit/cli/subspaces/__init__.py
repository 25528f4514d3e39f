"""The parts of `clothfit subspace`.

lengths (a length from a text) and inputs (those of a file) → building (a model, by
physics or by a network), playing (one motion, or many instances at once).
To add an action: its options in `cli/subspace.py`, and a module here.
"""
