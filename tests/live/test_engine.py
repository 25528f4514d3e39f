"""The engine in its thread: its steps are those of `simulate`; nothing it is asked for is lost or half done."""

import json
import threading
from collections import Counter
from weakref import WeakSet

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere

from clothfit import Diverged, InvalidInput, simulate
from clothfit.live.engine import Engine, end_all
from clothfit.scene.scene import dumps, load

pytestmark = pytest.mark.slow  # kernels that many tests share, compiled once


def scene(*objects, **fields):
    return load(document(*objects, **fields))


def stepped(engine, n):
    engine.step(n)
    return engine.latest()[1]


LIFT = {"times": [0.0, 0.2], "values": [{"x": 0, "y": 0, "z": 0}, {"x": 0, "y": 1, "z": 0}]}
PINS = [{"vertices": [0], "posKeys": LIFT}]
WORLDS = {
    "still": {},
    "windy": {"windVel": {"x": 1.0, "y": 0.0, "z": 3.0}},
    "explicit": {"integrationMethod": 1, "delta": 0.001},
    "sphere": {"colliders": [sphere(0.8, pos={"x": 1.0, "y": -1.0, "z": 1.0})]},
    "rubbing": {"colliders": [sphere(0.8, pos={"x": 1.0, "y": -1.0, "z": 1.0}, friction=0.4)]},
    "moving axes": {"frame": {"posKeys": {
        "times": [0.0, 0.3], "values": [{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0}]}}},
}  # fmt: skip


@pytest.mark.parametrize("fields", WORLDS.values(), ids=WORLDS)
def test_steps_are_those_of_simulate_to_the_last_bit(fields):
    own = scene(cloth(), cloth(3, 3), **fields)
    with Engine(own) as engine:
        found = [stepped(engine, 1) for _ in range(30)]
        engine.reset()
        assert engine.wait()
        assert np.array_equal(engine.latest()[1], np.concatenate([each.positions for each in own.cloths]))
        again = stepped(engine, 30)
    expected = simulate(own, 31).positions[1:]
    assert np.array_equal(np.array(found), expected)
    assert np.array_equal(again, expected[-1])


def test_pins_that_move_go_on_beyond_the_tables(monkeypatch):
    monkeypatch.setattr("clothfit.live.moving.ROWS", 8)
    own = scene(cloth(pins=PINS), optimizationIterations=8)
    with Engine(own) as engine:
        found = stepped(engine, 40)
    assert np.array_equal(found, simulate(own, 41).positions[-1])


def test_tables_grow_no_further_than_memory(monkeypatch):
    monkeypatch.setattr("clothfit.live.moving.ROWS", 8)
    monkeypatch.setattr("clothfit.live.moving.memory.missing", lambda needed: 1000 if needed > 40 * 240 else None)
    with Engine(scene(cloth(pins=PINS), optimizationIterations=10**8)) as engine:
        engine.step(40, wait=False)
        assert engine.wait(300)
        assert "are free; go back to the start" in str(engine.error)
        assert 8 <= engine.frame < 40
        engine.reset()
        engine.step(3)


def test_values_that_are_set_are_those_of_a_scene_that_has_them():
    own = scene(cloth())
    heavier = own.with_values([2 * own.cloths[0].mass], [own.cloths[0].stiffness], wind=(0.0, 0.0, 4.0), drag=[0.5])
    with Engine(own) as engine:
        engine.set(mass=2 * own.cloths[0].mass, wind=(0.0, 0.0, 4.0), drag=0.5)
        found = stepped(engine, 10)
        assert dumps(engine.scene) == dumps(heavier)
    assert np.array_equal(found, simulate(heavier, 11).positions[-1])


def test_pins_are_let_go_and_held_where_they_are():
    own = scene(cloth())
    with Engine(own) as engine:
        before = stepped(engine, 10)
        engine.set(pins=[3, 8])
        after = stepped(engine, 20)
        assert np.flatnonzero(load(json.loads(dumps(engine.scene))).cloths[0].fixed).tolist() == [3, 8]
    assert np.array_equal(after[[3, 8]], before[[3, 8]])
    assert np.array_equal(before[0], own.cloths[0].positions[0])
    assert after[0, 1] < before[0, 1]


def test_an_obstacle_that_is_moved_lifts_the_cloth():
    own = scene(cloth(vertIsFixed=[False] * 12), colliders=[sphere(0.5, pos={"x": 1.5, "y": -9.0, "z": 1.0})])
    with Engine(own) as engine:
        engine.set(colliders={"0": {"pos": [1.0, -0.7, 1.0]}})
        found = stepped(engine, 40)
        place = engine.scene.spheres[0].pos
    depth = 0.5 - np.linalg.norm(found - place, axis=1)
    # the weight of all, 0.19 kg, on one vertex presses it 0.19 · 9.81 / 1000 = 2 mm into the sphere; falling, more
    assert depth.max() < 0.05
    assert found[5, 1] > simulate(own, 41).positions[-1, 5, 1] + 0.5  # the vertex over its top stays there


def test_a_vertex_follows_the_hand_and_falls_when_let_go():
    own = scene(cloth())
    with Engine(own) as engine:
        engine.pull(11, (3.0, 1.0, 2.0))
        held = stepped(engine, 150)
        # κ = M ω², so the weight of the whole cloth, M g, would draw it g/ω² = 11 mm off; the springs pull as well
        assert np.linalg.norm(held[11] - (3.0, 1.0, 2.0)) < 0.5
        engine.release()
        assert stepped(engine, 10)[11, 1] < held[11, 1]


def test_a_frame_is_never_torn():
    own = scene(cloth(30, 30))
    seen, stop = Counter(), threading.Event()
    with Engine(own, speed=None) as engine:
        for each in engine._cloths:  # a cloth whose steps only count: every coordinate is the number of the step
            each.x = np.zeros_like(each.x)
            each.advance = lambda each=each: counted_step(each)

        def read():
            while not stop.is_set():
                number, positions = engine.latest()
                seen[bool((positions == number).all())] += 1

        readers = [threading.Thread(target=read) for _ in range(4)]
        engine.step()  # else a reader may find the cloth as it was loaded
        engine.start()
        for each in readers:
            each.start()
        while sum(seen.values()) < 2000:
            stop.wait(0.01)
        stop.set()
        for each in readers:
            each.join()
    assert seen[True] >= 2000
    assert seen[False] == 0


def counted_step(each):
    each.step += 1
    each.x = np.full_like(each.x, each.step)
    return True


def test_divergence_is_reported_and_reset_clears_it():
    own = scene(cloth(springStiffness=[1e5] * 23, damping=0.0), integrationMethod=0)
    with Engine(own) as engine:
        with pytest.raises(Diverged, match="diverged at step") as caught:
            engine.step(2000)
        assert engine.error is caught.value
        assert not engine.running
        last = engine.frame
        assert last == caught.value.step - 1
        assert np.isfinite(engine.latest()[1]).all()
        with pytest.raises(Diverged):
            engine.start()
        engine.set(stiffness=10.0)
        engine.reset()
        assert engine.step(5) == 5
        assert engine.error is None


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"colour": 1}, "there is no 'colour'"),
        ({"mass": -1.0}, "must be above 0"),
        ({"mass": "heavy"}, "numbers are needed"),
        ({"mass": [1.0, 2.0]}, "12 numbers"),
        ({"wind": [1.0, 2.0]}, "3 numbers"),
        ({"wind": [1.0, float("nan"), 2.0]}, "finite"),
        ({"pins": [12]}, "from 0 to 11"),
        ({"pins": "all"}, "a list of vertices"),
        ({"colliders": {"0": {"pos": [0, 1, 0]}}}, "there is no '0'"),
        ({"damping": [[1], [2, 3]]}, "numbers are needed"),
    ],
)
def test_what_cannot_be_set_changes_nothing(values, said):
    own = scene(cloth())
    with Engine(own) as engine:
        with pytest.raises(InvalidInput, match=said):
            engine.set(**values)
        assert engine.scene is own


def test_it_runs_by_itself_until_it_is_stopped():
    threads, told = threading.active_count(), threading.Semaphore(0)
    engine = Engine(scene(cloth()), speed=None, on_frame=told.release)
    engine.start()
    assert engine.running
    while engine.frame < 100:
        assert told.acquire(timeout=60)
    engine.pause()
    engine.wait()
    stood = engine.frame
    assert engine.step(3) == stood + 3
    engine.stop()
    assert threading.active_count() == threads
    assert engine.latest()[0] == stood + 3
    with pytest.raises(InvalidInput, match="stopped"):
        engine.start()


def test_the_interpreter_ends_after_the_thread_which_may_be_compiling(monkeypatch):
    begun, go = threading.Event(), threading.Event()

    def advance(self):
        begun.set()
        assert go.wait(60)

    monkeypatch.setattr(Engine, "_advance", advance)
    monkeypatch.setattr("clothfit.live.engine.PATIENCE", 0.01)
    monkeypatch.setattr("clothfit.live.engine.LIVING", WeakSet())  # other tests may have theirs
    engine = Engine(scene(cloth()))
    engine.start()
    assert begun.wait(60)
    engine.stop()
    assert engine.lives
    ending = threading.Thread(target=end_all)
    ending.start()
    assert ending.is_alive()
    go.set()
    ending.join(60)
    assert not engine.lives
