"""A network in place of physics: the next coordinates from the last two and what acts on the step.

signals (what acts on a step, as numbers) → weights (the network as plain arrays, in MODEL, and its motions,
compiled). layers (windows of recorded motions and the linear part, a step and its transpose, a window and its
gradient) → training (the descent) → learn (from data, and motions that come to rest, to MODEL).

To add an activation: its name in `weights.ACTIVATIONS`, its value in `weights.activate`, `play.Networks.step` and
`layers.Trained.step`, its derivative in `layers.Trained.pull`.
"""
