"""A session without a server: what a message does while the engine's thread is busy, as it is when code is compiled."""

import json
import threading

import pytest
from helpers.scenes import cloth, document

from clothfit.live import session as module
from clothfit.live.engine import Engine
from clothfit.live.session import Session
from clothfit.live.wire import unpacked
from clothfit.motion.simulate import simulate
from clothfit.scene.scene import load


@pytest.fixture
def held(monkeypatch):
    """Holds the engine's thread at its next return to the start, until it is set."""
    go, fulfil = threading.Event(), Engine._fulfil

    def late(self, wishes):
        if wishes.restart:
            assert go.wait(60)
        fulfil(self, wishes)

    monkeypatch.setattr(Engine, "_fulfil", late)
    return go


@pytest.fixture
def session(monkeypatch):
    monkeypatch.setattr(module, "SOON", 0.0)
    told = []
    scene = load(document())
    made = Session(scene, told.append, lambda: None, simulate(scene, 3))
    made.told = told
    yield made
    made.close()


def test_a_scene_that_is_loaded_holds_nothing_up_and_no_frame_of_another_is_sent(held, session):
    try:
        assert unpacked(session.frame_packet()).positions.shape == (1, 12, 3)
        done = session.answer({"type": "load", "scene": document(cloth(3, 3))})
        assert done["type"] == "done"
        scenes = [message for message in session.told if isinstance(message, dict) and message["type"] == "scene"]
        assert scenes[-1]["mesh"]["vertex_counts"] == [9]
        assert session.frame_packet() is None  # the engine still has the twelve vertices of before
        assert session.answer({"type": "set", "values": {"damping": 2.0}})["type"] == "done"
        assert session.answer({"type": "step", "n": 2})["type"] == "done"
        assert session.frame_packet() is None
    finally:
        held.set()
    assert session.engine.wait(300)
    last = unpacked(session.frame_packet())
    assert (last.generation, last.number, last.positions.shape) == (scenes[-1]["generation"], 2, (1, 9, 3))
    assert json.loads(session.text_now())["objects"][0]["damping"] == 2.0


def test_a_return_to_the_start_outlives_the_failure_of_the_step_before(held, session):
    engine = session.engine
    session.answer({"type": "reset"})
    with engine._change:
        engine._wishes.restart = True  # asked for while a step is taken, which then fails
    engine._fail(module.InvalidInput("diverged"))
    assert engine.error is None
    held.set()
    assert engine.wait(60)
    assert (engine.error, engine.frame) == (None, 0)
