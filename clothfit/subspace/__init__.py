"""A cloth in a subspace of its motions: x = x₀ + U q with a few dozen coordinates q, much cheaper to play.

inputs → recording (motions under random inputs, on disk) → translation, basis (U from these motions, and vibration) →
physics (the scene's steps on U, from few weighted elements) → model (the file) → build, play, frames (what a player
shows), validation, break_even, onnx. Nothing here is loaded until a command asks for it.

To vary another input: its range in `inputs.Ranges`, its items in `inputs.episode`, its option in `cli/subspace`.

To add another way to step: a value of `method` in `model`, and what `play` calls for it.
"""
