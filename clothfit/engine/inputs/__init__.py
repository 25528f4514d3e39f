"""Inputs over time: wind, gravity, pins and colliders that move.

files (keys that come from a file) → interpolation (their values at any time) → sampling (values at the times of the
steps, in axes that may move) → tables (what a step and its derivatives read of them); fitted_paths (pins whose paths a
fit changes); knots (of a search, beside keys); body_files (meshes of colliders) → poses (where their vertices are).
A scene without keys has empty tables, and its steps do nothing more than a comparison. Inputs are those at the end of a
step for the implicit methods, at its beginning for the explicit ones; a pin is on its path at every step's end.
"""
