"""The balances of momentum along a target motion: linear equations for masses and stiffnesses.

balances (each step's, from the positions that are seen) → rows (their products with parameters, and their normal
matrix, sparse) → trimming (which steps can be in balance, and in which form they were taken).
"""
