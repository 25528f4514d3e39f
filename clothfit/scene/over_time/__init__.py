"""What changes over time.

`keys` are values at times, which the scene has or a file beside it; the wind, gravity, pins, colliders and the axes of
the scene follow them. `forces` are applied to vertices; they come with a simulation, not with the scene's file.

To add what keys can move: a field in `keys` or in the schema, and its table in `engine/inputs`.
"""
