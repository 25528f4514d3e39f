"""A network in place of physics: the next coordinates from the last two and what acts on the step.

signals (what acts on a step, as numbers) → weights (the network as plain arrays, and in MODEL) → step, roll (its
motions, compiled). recipe (how to train) → windows (of recorded motions), settle (motions that come to rest) → prior
(the linear part) → layers (a step and its transpose) → unrolled (a window and its gradient) → descent → training →
learn, teach (from data to MODEL).

To add an activation: its name in `weights.ACTIVATIONS`, its value in `step.activate` and `layers.Trained.activated`,
its derivative in `layers.Trained.pull`.
"""
