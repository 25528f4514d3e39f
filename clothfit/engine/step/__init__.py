"""One time step of a cloth, and beside it its transpose (pullback) and its tangent (pushforward).

explicit and implicit are the integrators, guard shortens a step that would add energy, transition chooses by the
scene's `integrationMethod`.
To add an integrator: a module with step, pullback and pushforward, and a branch in each function of transition.
"""
