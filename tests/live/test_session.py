"""A session without a server: what a message does while other things are under way."""

import json
import threading

import pytest
from helpers.scenes import cloth, document

from clothfit import Engine, InvalidInput, load, simulate
from clothfit.live import changes
from clothfit.live import session as module
from clothfit.live.commands import answer, answer_long
from clothfit.live.session import Session
from clothfit.live.wire import unpacked

OTHER = {"type": "load", "id": 7, "scene": document(cloth(3, 3))}


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
    made.told_all = told
    yield made
    made.close()


class Held:
    """A process that says what a test makes it say."""

    def __init__(self, name, heard, **arguments):
        self.name, self.heard, self.arguments, self.killed = name, heard, arguments, False

    def kill(self):
        self.killed = True


@pytest.fixture
def process(monkeypatch):
    """The process that reads a scene, held; those that record targets do nothing."""
    made = []

    def start(name, heard, **arguments):
        made.append(Held(name, heard, **arguments))
        return made[-1]

    monkeypatch.setattr("clothfit.live.task.Task", start)
    monkeypatch.setattr("clothfit.live.session.Task", start)
    return made


def scenes(session):
    return [each for each in session.told_all if isinstance(each, dict) and each["type"] == "scene"]


def test_what_moves_goes_on_while_a_scene_is_loaded_and_frames_bear_their_scene(held, process, session):
    loading = answer(session, OTHER)
    assert session.status()["status"]["busy"] == "load"
    assert not loading.answer.done()
    assert unpacked(session.frame_packet()).positions.shape == (1, 12, 3)
    assert answer(session, {"type": "step"})["type"] == "done"
    assert session.engine.wait(300)
    assert unpacked(session.frame_packet()).number == 1
    process[0].heard("id", {"id": 7})
    process[0].heard("done", {"scene": load(document(cloth(3, 3)))})
    found = loading.answer.result(0)
    assert (found["type"], found["id"], found["status"]["busy"]) == ("done", 7, "record")
    assert scenes(session)[-1]["mesh"]["vertex_counts"] == [9]
    assert session.frame_packet() is None  # the engine still has the twelve vertices of before
    assert answer(session, {"type": "set", "values": {"damping": 2.0}})["type"] == "done"
    assert answer(session, {"type": "step", "n": 2})["type"] == "done"
    assert session.frame_packet() is None
    held.set()
    assert session.engine.wait(300)
    last = unpacked(session.frame_packet())
    assert (last.generation, last.number, last.positions.shape) == (found["status"]["generation"], 2, (1, 9, 3))
    assert json.loads(session.text_now())["objects"][0]["damping"] == 2.0


@pytest.mark.parametrize(
    "message",
    [OTHER, {"type": "set", "values": {"damping": 1.0}}, {"type": "undo"}, {"type": "estimate"},
     {"type": "control", "keys": [{"time": 1.0}]}],
    ids=lambda message: message["type"],
)  # fmt: skip
def test_what_would_be_lost_with_a_scene_is_refused_while_another_is_loaded(process, session, message):
    answer(session, OTHER)
    found = answer(session, message)
    assert found["type"] == "refused"
    assert "is being loaded" in found["reason"]


def test_a_load_is_given_up(process, session):
    loading = answer(session, OTHER)
    assert answer(session, {"type": "cancel"})["type"] == "done"
    assert process[0].killed
    assert loading.answer.result(0) == {"type": "refused", "of": "load", "id": 7, "reason": "the load was cancelled"}
    process[0].heard("done", {"scene": load(document(cloth(3, 3)))})  # said before it was ended
    assert scenes(session) == []
    assert session.status()["status"]["busy"] is None


def test_a_sender_that_has_waited_long_is_answered_and_a_failure_after_that_is_told(process, session):
    loading = answer(session, OTHER)
    so_far = session.still_loading(loading)
    assert (so_far["type"], so_far["id"], so_far["status"]["busy"]) == ("done", 7, "load")
    process[0].heard("failed", {"reason": "no scene"})
    ended = [each for each in session.told_all if each["type"] == "ended"]
    assert ended == [{"type": "ended", "of": "load", "status": "failed", "reason": "no scene"}]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (json.dumps({"type": "load", "id": 7, "scene": "{"}), "line 1"),
        (json.dumps({"type": "load", "id": 7, "sense": 1}), "no field 'sense'"),
        (json.dumps({"type": "play", "id": 7}), "too large"),
    ],
    ids=range(3),
)
def test_a_long_message_is_parsed_in_a_process_of_its_own(session, text, reason):
    found = answer_long(session, text).answer.result(300)
    assert (found["type"], found["of"], found["id"]) == ("refused", "load", 7)
    assert reason in found["reason"]


def test_large_scenes_are_remembered_less_often(session, monkeypatch):
    monkeypatch.setattr(changes, "MOST_BYTES", 3 * changes.size(session.scene))
    for damping in range(1, 8):
        answer(session, {"type": "set", "values": {"damping": float(damping)}})
    assert len(session.history) == 3
    for damping in (6.0, 5.0, 4.0):
        assert answer(session, {"type": "undo"})["values"]["damping"] == [damping]


def test_a_return_to_the_start_outlives_the_failure_of_the_step_before(held, session):
    engine = session.engine
    answer(session, {"type": "reset"})
    with engine._change:
        engine._wishes.restart = True  # asked for while a step is taken, which then fails
    engine._fail(InvalidInput("diverged"))
    assert engine.error is None
    held.set()
    assert engine.wait(60)
    assert (engine.error, engine.frame) == (None, 0)
