"""Forces, one file each: a NamedTuple of constant arrays and the same few functions on it.

Around a linearisation point (y, u), the implicit step models a force as a function of the new velocity w:

    F(w) = f(y, u) + K s + D (w − u),     s = x + h w − y

with f the force, K and D, at (y, u), the position and velocity Jacobians that the editor's engine keeps (not always the
true ones), and s how far the step ends from the point of linearisation. Each module has

    energy(force, y)                                              potential energy, J: −∂/∂y is what of f is left at
                                                                  u = 0 in still air; none of the air
    damping_power(force, y, u, w)                                 f'·w, W, of the part f' of f that damps, at (y, u);
                                                                  left out where nothing does
    add_force(force, y, u, f)                                     f += f(y, u)
    add_damping(force, y, u, scale, q, out)                       out += scale · D q; left out where D = 0
    add_step(force, y, u, h, ahead, A, b)                         A −= h² K + h D,  b += h (f − D u) unless b is empty,
                                                                  and where y is h u `ahead` also −h² K u; returns
                                                                  `energy` for `step.guard`, of weight 0, unless `ahead`
    add_pullback(force, y, u, w, s, lam, h, grad, gy, gu)         gradient of φ = h λᵀ F(w), s and w held fixed:
                                                                  gy += ∂φ/∂y,  gu += ∂φ/∂u,  grad += ∂φ/∂p
    add_pushforward(force, y, u, w, s, dy, du, direction, h, out) out += h dF(w), s and w held fixed

The derivatives treat K and D as the functions that the step uses, so they belong to the step that is really taken.

Symbols, all in SI units: n vertices; x, v position and velocity before a step, (n, 3), and w the velocity after it;
y, u where forces are linearised; m mass, k stiffness, M the masses as a diagonal matrix; h time step; A w = b the
step's linear system; lam or λ the adjoint variable, the solution of A λ = ∂G/∂w; a bar (x_bar) marks a gradient, d in
front (dx) a change. A vertex or spring index is i; a and b are a spring's ends, p0 p1 p2 the components of a vector p.

To add a force: write such a module, give `System` a field for it and `system.build` a line, and add a line to each
function of `forces/total.py` and of `motion/energy.py`, which keeps the accounts.

To add a kind of parameter p: a row in `kinds.KINDS`; a field in `arrays.Elements`, in the same order, and its lines in
`system.with_elements` and `system.all_elements`; the field in the JSON schema, there also in `fit`, and its attribute
in `scene.Cloth` or `scene.Scene`; what hides it in `identifiability.unobservable`; and in each force that depends on it

    add_pullback       grad.p += ∂φ/∂p            where `grad.p` is not empty
    add_pushforward    out += h ∂F/∂p · dp        where `direction.p` is not empty

An empty array means that the derivative is not needed, so a scene pays only for the kinds it fits. Fit vector, bounds,
coordinates, saving, summaries and the tests of derivatives read the table.
"""
