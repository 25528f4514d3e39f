"""Forces, one file each: a NamedTuple of constant arrays and the same few functions on it.

Around a linearisation point (y, u), the implicit step models a force as a function of the new velocity w:

    F(w) = f(y, u) + K(y) s + D(y) (w − u),     s = x + h w − y

with f the force, K and D the position and velocity Jacobians that the editor's engine keeps (not always the true
ones), and s how far the step ends from the point of linearisation. Each module has

    add_force(force, y, u, f)                                     f += f(y, u)
    add_damping(force, y, scale, d, out)                          out += scale · D(y) d
    add_step(force, y, u, h, A, b)                                A −= h² K + h D,  b += h (f − D u)
    add_pullback(force, y, u, w, s, lam, h, grad, gy, gu)         gradient of φ = h λᵀ F(w), s and w held fixed:
                                                                  gy += ∂φ/∂y,  gu += ∂φ/∂u,  grad += ∂φ/∂p
    add_pushforward(force, y, u, w, s, dy, du, direction, h, out) out += h dF(w), s and w held fixed

All vectors are (vertices, 3) arrays in SI units; the derivatives treat K and D as the functions that the step uses,
so they belong to the step that is really taken. To add a force: write such a module, give `System` a field for it, and
add one line to each function of `forces/total.py`.
"""
