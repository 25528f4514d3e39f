"""One time step of a cloth, beside it its transpose (pullback) and its tangent (pushforward)."""
