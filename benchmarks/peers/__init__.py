"""Other ways to write the same simulation, to measure against: one file each, as a competent user would write it.

Each has a class with

    Peer(problem)                                          raises ImportError where its library is missing
    name                                                   as the tables call it
    steps(n, tolerance)                                    positions (n + 1, vertices, 3), m
    cost_and_gradient(k, target, tolerance)                Σ |x − target|², m², over all frames of the target, and its
                                                           exact derivative (springs,) by the stiffnesses k; None where
                                                           it has no derivative
    iterations                                             of the linear solver per step, in the last call of `steps`

All compute in double precision on one thread, take the linearised implicit step of the scene's contract, and stop the
linear solver where the residual is at most `tolerance` times the right-hand side, each in its own norm-wise loop.
"""
