"""The parts of `clothfit info` for files that are no scenes.

records (what they hold, in numbers) → lines (the same for people).
To add a kind of file: its name in `formats/recognition.py`, a function in each of the two.
"""
