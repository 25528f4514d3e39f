"""The parts of `clothfit evaluate`.

evaluate_speed measures integrators, speed against error; evaluate_subspace compares a subspace with its scene.
To add a column: see the page of `evaluation`, then evaluate_speed.
"""
