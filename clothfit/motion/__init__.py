"""Motions: positions over time, simulated or read, compared in time and space with what the scene expects.

motion (the record and its file) → divergence (how one ended) → simulate → energy. times puts frames on the grid of
steps; native and foreign read files, alignment and markers find whose axes and vertices they are; files chooses.
To read another format: see the page of `formats`.
"""
