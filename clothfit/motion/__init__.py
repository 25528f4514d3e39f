"""Motions: positions over time, simulated or read from a file.

motion (the record, its checks and its file) comes first. divergence (the error, and the states before it) → simulate →
energy follow a scene; times puts frames on the grid of steps; degrade makes a motion look like a capture.
correspondence says what the points of a file are, feet where those of scans are nearest to a cloth.
For files, markers (their vertices) serve foreign, which reads any format and doubts axes and units; files writes, and
chooses between this program's format and others.
To read another format: see the page of `formats`.
"""
