"""Systems whose steps cannot all be taken as the scene format has them, and what their motions have of energy."""

from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.rollout import Rollout
from clothfit.engine.step import guard
from clothfit.engine.step.states import velocity
from clothfit.engine.system import System, build
from clothfit.scene.scene import Scene
from helpers import physics
from helpers.physics import ball, thing, xyz
from helpers.scenes import cloth


def crushed(side: int = 5, factor: float = 5.0, **fields: Any) -> System:
    """A cloth whose springs are at a fraction of their rest length, not quite flat, one side fixed."""
    x = np.array([(i, 0.0, j) for j in range(side) for i in range(side)]) / (side - 1)
    x += 1e-3 * np.random.default_rng(3).normal(size=x.shape)
    held = [i < side for i in range(side * side)]
    made = cloth(side, side, vertIsFixed=held, vertPos=[xyz(p) for p in x], vertMass=[0.01] * side**2)
    rest = factor * lengths(made, x)
    stiff = {"springRestLength": rest.tolist(), "springStiffness": [50.0] * len(rest)}
    return physics.system({**made, **stiff}, **fields)


def lengths(made: dict[str, Any], x: Array) -> Array:
    """The lengths of an object's springs at x."""
    ends = np.reshape(made["springs"], (-1, 2))
    return np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)


def turning() -> System:
    """A stiff pendulum that is let go level: tangents lead far from its circle."""
    bob = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], mass=0.5, stiffness=1e5, fixed=[0])
    return physics.system(bob, delta=0.2)


def falling(
    speed: float, mass: float = 0.0014, stiffness: Any = (25, 185), side: int = 8, spacing: float = 0.2, **fields: Any
) -> Scene:
    """A level cloth 10 cm over a sphere of 1 m that falls at this speed, m/s, with steps of 20 ms."""
    n = side * side
    x = np.array([(i, 0.0, j) for j in range(side) for i in range(side)]) * spacing
    x += np.array([-0.5, 0.0, -0.5]) * (side - 1) * spacing + [0.0, 0.6, 0.0]
    own = {"vertPos": [xyz(p) for p in x], "vertVel": [xyz((0, -speed, 0))] * n, "vertMass": [mass] * n}
    made = cloth(side, side, vertIsFixed=[False] * n, damping=0.0, dragCoefficient=0.0, **own)
    rest = lengths(made, x)
    stiff = {"springRestLength": rest.tolist(), "springStiffness": np.linspace(*stiffness, len(rest)).tolist()}
    ground = {"colliders": [ball((0, 0, 0), 0.5)], "delta": 0.02}
    return physics.scene({**made, **stiff, "optimizationSettings": "LL"}, **{**ground, **fields})


def fallen(method: int, newton: int = 1) -> System:
    """A fall of few vertices whose early steps come soon, and go on."""
    return build(falling(12.0, side=4, spacing=0.15, forwardSubSteps=newton, integrationMethod=method), 0)


def energies(system: System, memory: Rollout) -> tuple[Array, Array]:
    """Kinetic and stored energy, and that of the weight, at each state (T + 1,), J."""
    inner = [guard.energy(system, memory.x[t], velocity(memory, t)) for t in range(memory.steps + 1)]
    return np.array(inner), -np.einsum("n,tnc,c->t", system.vertex.mass, memory.x, system.vertex.gravity)
