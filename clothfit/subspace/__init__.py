"""A cloth in a subspace of its motions: x = x₀ + U q with a few dozen coordinates q, hundreds of times cheaper to play.

inputs (a list of keys ↔ a scene) → variation (random inputs) → recording (motions of them, on disk) → carrier, basis
(U from these motions, and vibration) → samples (the forces' elements in the subspace) → nnls, cubature (few of them,
weighted) → step (the scene's implicit step on U, compiled) → reduced (all steps, its adjoint and tangent) → model
(the file) → build, play, judge. Nothing here is loaded until a command asks for it.

To add another way to step: a value of `method` in `model`, and what `play` calls for it.
"""
