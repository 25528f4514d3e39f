"""The gentlest controls that take a cloth through keyframes.

Read `keyframes` (where the cloth is to be, and when, and a first path through the keys) and `controls` (what may move);
`control` calls the rest. Forces of every vertex and step: `closed_loop` (effort and its gradient, along motions that
springs hold near that path), `feedback` (gains around the least effort), and `following`, which goes down to it and
finds forces that play back to the same motion, bit for bit.
Handles, wind, velocities and forces in a basis: `controls` (the numbers that a search moves), `shooting` (how far they
lead from the keys, by the simulation, with derivatives) and `steering`.

To add a control: an input of the step with its derivatives (`engine/forces/applied.py` is the model), and a block in
`controls`. To add what a key can ask for: `keyframes`, and its residuals in `closed_loop` and `shooting`.
"""
