"""All forces of a cloth together: the functions that the page of this folder lists, on a System."""

from __future__ import annotations

from clothfit.engine.forces import applied, contact, spheres, springs, vertex, wind
from clothfit.kernels.kernel import kernel


@kernel
def add_force(system, y, u, f):
    vertex.add_force(system.vertex, y, u, f)
    springs.add_force(system.springs, y, u, f)
    wind.add_force(system.faces, y, u, f)
    spheres.add_force(system.spheres, y, u, f)
    contact.add_force(system.colliders, y, u, f)
    contact.add_force(system.contact, y, u, f)
    applied.add_force(system.applied, y, u, f)


@kernel
def add_damping(system, y, u, scale, q, out):
    add_damping_alone(system, y, u, scale, q, out)
    springs.add_damping(system.springs, y, u, scale, q, out)
    wind.add_damping(system.faces, y, u, scale, q, out)
    contact.add_damping(system.contact, y, u, scale, q, out)


@kernel
def add_step(system, y, u, h, ahead, A, b):
    stored = vertex.add_step(system.vertex, y, u, h, ahead, A, b)
    stored += springs.add_step(system.springs, y, u, h, ahead, A, b)
    stored += wind.add_step(system.faces, y, u, h, ahead, A, b)
    stored += spheres.add_step(system.spheres, y, u, h, ahead, A, b)
    stored += contact.add_step(system.colliders, y, u, h, ahead, A, b)
    stored += contact.add_step(system.contact, y, u, h, ahead, A, b)
    stored += applied.add_step(system.applied, y, u, h, ahead, A, b)
    return stored


@kernel
def stored_energy(system, y, x):
    """The energy at y of springs and colliders, and of contacts with spheres that there are at x, (n, 3) each, J."""
    held = springs.energy(system.springs, y) + spheres.energy_of_contacts(system.spheres, y, x)
    return held + contact.energy(system.colliders, y)


@kernel
def add_damping_alone(system, y, u, scale, q, out):
    """`add_damping` of the forces that act on each vertex for itself."""
    vertex.add_damping(system.vertex, y, u, scale, q, out)
    contact.add_damping(system.colliders, y, u, scale, q, out)


@kernel
def add_pullback(system, y, u, w, s, lam, h, grad, gy, gu):
    add_pullback_alone(system, y, u, w, s, lam, h, grad, gy, gu)
    springs.add_pullback(system.springs, y, u, w, s, lam, h, grad, gy, gu)
    wind.add_pullback(system.faces, y, u, w, s, lam, h, grad, gy, gu)
    contact.add_pullback(system.contact, y, u, w, s, lam, h, grad, gy, gu)


@kernel
def add_pullback_alone(system, y, u, w, s, lam, h, grad, gy, gu):
    """`add_pullback` of these."""
    vertex.add_pullback(system.vertex, y, u, w, s, lam, h, grad, gy, gu)
    spheres.add_pullback(system.spheres, y, u, w, s, lam, h, grad, gy, gu)
    contact.add_pullback(system.colliders, y, u, w, s, lam, h, grad, gy, gu)
    applied.add_pullback(system.applied, y, u, w, s, lam, h, grad, gy, gu)


@kernel
def add_pushforward(system, y, u, w, s, dy, du, direction, h, out):
    add_pushforward_alone(system, y, u, w, s, dy, du, direction, h, out)
    springs.add_pushforward(system.springs, y, u, w, s, dy, du, direction, h, out)
    wind.add_pushforward(system.faces, y, u, w, s, dy, du, direction, h, out)


@kernel
def add_pushforward_alone(system, y, u, w, s, dy, du, direction, h, out):
    """`add_pushforward` of these, and of the contact of a cloth with itself, whose law is one for all of it."""
    vertex.add_pushforward(system.vertex, y, u, w, s, dy, du, direction, h, out)
    spheres.add_pushforward(system.spheres, y, u, w, s, dy, du, direction, h, out)
    contact.add_pushforward(system.colliders, y, u, w, s, dy, du, direction, h, out)
    contact.add_pushforward(system.contact, y, u, w, s, dy, du, direction, h, out)
    applied.add_pushforward(system.applied, y, u, w, s, dy, du, direction, h, out)
