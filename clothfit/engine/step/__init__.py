"""One time step of a cloth, and beside it its transpose (pullback) and its tangent (pushforward).

explicit, implicit and bdf2 are the integrators, guard shortens a step that would add energy.
To add an integrator: a module with step, pullback and pushforward, a loop in `march`, and two in `derivative/adjoint`.
"""
