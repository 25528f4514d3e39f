"""Four numbers at once: compiled intrinsics, and their NumPy twin.

compiled and plain have the same functions; operations chooses between them.
To add an operation: write it in compiled and plain, name it in operations, and compare the two in the tests.
"""
