"""One cloth that goes on step by step, with values that may change between two steps.

All cloths move by the form of a system that has inputs over time, colliders and applied forces, empty where the scene
has none: then nothing is compiled again when a vertex is pulled or a wind begins to blow. Their steps are those of
`clothfit.simulate` to the last bit, as long as nothing is changed.

A vertex that is pulled by hand feels κ (R − x): R goes where the hand is, and κ grows with the mass around, so that the
pull is as brisk for a handkerchief as for a sail (`grip`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base import memory
from clothfit.base.arrays import Array, Elements
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces import applied, contact
from clothfit.engine.rollout import empty, fill
from clothfit.engine.step import guard, implicit
from clothfit.engine.system import BDF2, build, with_elements
from clothfit.scene.scene import Scene

ROWS, FEWEST = 4096, 64
"""Steps that the tables of moving inputs have at first, and at least; they grow as the motion goes on."""

TABLES = 32 << 20
"""Bytes that they take at first, about."""

BRISK = 30.0
"""1/s, ω: a pulled vertex swings with the mass of the cloth as a spring of κ = m ω² would."""


class Grip(NamedTuple):
    """A vertex that is pulled."""

    vertex: int
    place: Array  # (3,), m, in the world


def nothing() -> None:
    """Look for no request to end: that is the engine's business."""


class Moving:
    """A cloth of a scene at a moment."""

    def __init__(self, scene: Scene, index: int) -> None:
        """The cloth at the start. Raises InvalidScene, for inputs in files."""
        self.index, self.step = index, 0
        self.grip: Grip | None = None
        self._rows = min(ROWS, max(TABLES // row_bytes(scene, index), FEWEST))
        self._prepare(scene)
        self.x, self.v = self.system.x0.copy(), self.system.v0.copy()
        self._before, self._ready, self._guard_state = (self.x, self.v), False, guard.start(self.system)

    def _prepare(self, scene: Scene) -> None:
        """Make the system and its memory for a scene."""
        self.scene = scene
        whole = build(scene, self.index, air=True, steps=self._rows, whole=True)  # with every part that may be wanted
        assert whole.inputs is not None
        self.system = whole._replace(applied=applied.build(whole.inputs.force.shape[1], len(whole.x0)))
        self.tolerance = scene.tolerance
        work = implicit.workspace(self.system)
        if self.step:  # first guesses of the solver, of as many vertices
            work = work._replace(past=self._work.past)
        self._work: implicit.Workspace = work
        self._room = empty(self.system, 1)

    def advance(self) -> bool:
        """Take one step; returns whether it is good. A bad one leaves the state as it was, and `bad` has where it led.
        """
        inputs = self.system.inputs
        assert inputs is not None
        if self.step + 2 >= inputs.steps:
            self._grow()
            self._hold(self.grip)
        x_before, v_before = self._before
        part = self._room._replace(
            v=self.v, x_before=x_before, v_before=v_before, ready=self._ready, first=self.step
        )  # fmt: skip
        part.x[0], part.guard_state[0] = self.x, self._guard_state
        if fill(self.system, self.tolerance, self._work, part, nothing) < 1:
            self.bad = part.x[1].copy(), part.velocity(1).copy()
            return False
        last = part.part(1, 1)
        two = self.system.method == BDF2
        self._before = (last.x_before.copy(), last.v_before.copy()) if two else (self.x, self.v)
        self.x, self.v = last.x[0].copy(), last.v.copy()
        self._ready, self._guard_state = last.ready, last.guard_state[0].copy()
        self.step += 1
        return True

    def _grow(self) -> None:
        """Make the tables twice as long. Raises InvalidInput where memory does not suffice."""
        needed = 2 * self._rows * row_bytes(self.scene, self.index)
        free = memory.missing(2 * needed)
        if free is not None:
            raise InvalidInput(
                f"{self.scene.name}: moving inputs of {2 * self._rows} steps need {memory.human(2 * needed)}, of which "
                f"{memory.human(free)} are free; go back to the start"
            )
        self._rows *= 2
        self._prepare(self.scene)

    def rebuild(self, scene: Scene) -> None:
        """Go on in a scene whose pins or obstacles differ, or whose tables are to be longer."""
        self._prepare(scene)
        self._guard_state = np.append(self._guard_state[: contact.BESIDE], guard.start(self.system)[contact.BESIDE :])
        still = ~self.system.vertex.free
        self.v = np.where(still[:, None], 0.0, self.v)
        self._hold(self.grip)
        self._changed()

    def retune(self, scene: Scene) -> None:
        """Go on with other values of a scene that is otherwise the same."""
        self.scene = scene
        self.system = with_elements(self.system, values_of(scene, self.index))
        self._hold(self.grip)
        self._changed()

    def pull(self, grip: Grip | None) -> None:
        """Pull a vertex to a place from now on, or let go."""
        self.grip = grip
        self._hold(grip)
        self._changed()

    def _hold(self, grip: Grip | None) -> None:
        """Write the pull to where the forces read it; meanwhile energy may rise."""
        own, inputs, scene = self.system.applied, self.system.inputs, self.scene
        assert own is not None
        assert inputs is not None
        if len(inputs.gain):  # the scene's own forces pull, by their tables
            return
        own.gain[:] = 0.0
        if grip is not None:
            own.gain[grip.vertex] = scene.cloths[self.index].mass.sum() * BRISK**2
            own.place[grip.vertex] = grip.place
        own_energy = scene.changes or scene.cloths[self.index].pins
        energetic = bool(grip is not None or own_energy or (scene.forces and scene.forces.pulls))
        self.system = self.system._replace(inputs=inputs._replace(energetic=energetic))

    def _changed(self) -> None:
        """What contacts may bring the state to is its own energy, whatever a change or a hand has brought."""
        if self.step:
            self._guard_state[guard.BOUND] = guard.energy(self.system, self.x, self.v)


def row_bytes(scene: Scene, index: int) -> int:
    """Bytes that a step of a cloth takes in the tables of its moving inputs, about: places, forces."""
    cloth = scene.cloths[index]
    led = int(np.count_nonzero(cloth.fixed)) if scene.frame or cloth.pins else 0
    return 24 * (led + (3 * len(cloth.mass) if scene.forces else 0) + 8)


def values_of(scene: Scene, index: int) -> Elements:
    """The values of a cloth that may change while it moves."""
    cloth = scene.cloths[index]
    friction, contact = scene.friction, scene.contact
    return Elements(
        mass=cloth.mass, stiffness=cloth.stiffness, damping=np.array([cloth.damping]), drag=np.array([cloth.drag]),
        rest=cloth.rest, wind=np.array(scene.wind), gravity=np.array(scene.gravity), friction=friction, contact=contact,
    )  # fmt: skip
