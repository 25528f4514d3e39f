"""Forces over time that take a cloth through keyframes, with the least effort.

Read `keyframes` (where the cloth is to be, and when), `reference` (a first path through them), `closed_loop` (effort
and its gradient, along motions that springs hold near that path), `descent` (from there to the least effort),
`recording` (forces that play back to the same motion, bit for bit), `feedback` (gains around it), and `control`, which
calls them. `course` has what pictures and reports show of the result.

To add a control: an input of the step with its derivatives (`engine/forces/applied.py` is the model), and its part of
the unknowns in `closed_loop`. To add what a key can ask for: `keyframes`, and its residuals in `closed_loop`.
"""
