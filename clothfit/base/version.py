"""The version of the program, said here only."""

__version__ = "0.1.0"
