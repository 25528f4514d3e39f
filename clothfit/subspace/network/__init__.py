"""A network in place of physics: the next coordinates from the last two and what acts on the step.

signals (what acts on a step, as numbers) → weights (the network as plain arrays, and in MODEL) → step, roll (its
motions, compiled). To add an activation: its name in `weights.ACTIVATIONS`, and its value in `step.activate`.
"""
