"""Four numbers at once: compiled intrinsics, their NumPy twin, and what is made of both.

compiled and plain have the same functions; operations chooses between them; products are those of 3-vectors.
To add an operation: write it in compiled and plain, name it in operations, and compare the two in the tests.
"""
