"""What a subspace is made of: motions of a scene under many inputs.

inputs (a list of keys outside of a scene ↔ a scene with them) → variation (such lists at random, within ranges) →
recording (their motions, in parallel and straight to disk, and the file that they are in).

To vary another input: its range in `variation.Ranges`, its items in `variation.episode`, its option in `cli/subspace`.
"""
