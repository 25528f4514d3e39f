"""The parts of `clothfit new`.

asked (what its options ask for) → cloth (the mesh of a plane or a file, welded, placed and held).
To add an option: a field of `asked.Asked`, what it does in cloth, and its declaration in `new`.
"""
