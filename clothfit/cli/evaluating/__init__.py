"""The parts of `clothfit evaluate`.

evaluate_speed measures integrators and fits, speed against error; speed_table prints what it found.
To add a column: see the page of `evaluation`, then speed_table.
"""
