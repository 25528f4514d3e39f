"""Checkpoints: the file, what is in it, and fits that go on to the same minimum, wherever they were ended."""

import functools
import json
import os

import numpy as np
import pytest
from helpers.fits import Watching, estimate
from helpers.scenes import even, load_text, needs_full_disk, trial, write_scene

from clothfit.base import checkpoint as module
from clothfit.base.errors import InvalidInput
from clothfit.cli.parts import checkpoints
from clothfit.cli.program import run
from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import save_motion
from clothfit.objective.objective import Objective
from clothfit.optimise.checkpoint import Checkpoint, State, decoded
from clothfit.optimise.status import ModelFit, Status
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # starts processes


STATE = State(
    start=np.array([1.0, 2.0, 0.1 + 0.2]), best=np.array([0.5, 1.0, 5e-324]), cost=1.0 / 3.0, gradient=np.arange(3.0),
    centre=np.zeros(2), tau=(0.3, np.inf), y=np.ones(2), radius=0.5, window=20, before=np.ones(3), before_cost=np.inf,
    history=(np.inf, 2.0), beside=2, seconds=12.5, warnings=["a word"], status=Status.LIMIT, model="R", substeps=4,
    rungs=[ModelFit("F", 2, 1.0 / 3.0, np.array([1.0, 2.0, 5e-324]), 1.5), ModelFit("R", 3, 0.1, np.ones(3), 0.0)],
    best_centre=np.full(2, 0.1), best_tau=(0.2,),
)  # fmt: skip
SAME = {"scene": "#1", "method": "auto"}


def written(path, identity=SAME, **changes):
    """A checkpoint of that fit, with a file of its state."""
    file = Checkpoint(path, identity=identity)
    file.save(lambda: STATE._replace(**changes), now=True)
    return file


def same(one, other):
    """Whether two states are equal to the bit."""
    for a, b in zip(one, other, strict=True):
        assert type(a) is type(b)
        if isinstance(a, (tuple, list)) and a and isinstance(a[0], ModelFit):
            for mine, theirs in zip(a, b, strict=True):
                same(mine, theirs)
            continue
        assert a.tobytes() == b.tobytes() if isinstance(a, np.ndarray) else a == b


# --- the file


def test_a_file_gives_back_every_bit(tmp_path):
    same(written(tmp_path / "fit.checkpoint").read(3), STATE)
    assert os.listdir(tmp_path) == ["fit.checkpoint"]


def test_every_damage_is_noticed():
    data = module.encoded("fit", SAME, STATE._asdict())
    same(decoded(data, "x")[1], STATE)
    damaged = [data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :] for i in range(len(data))]
    told = []
    for broken in [*damaged, *(data[:i] for i in range(len(data)))]:
        try:
            _, state = decoded(broken, "x")
        except InvalidInput as error:
            told.append(str(error))
        else:
            same(state, STATE)  # a bit of the archive that says nothing, as in a date
    assert all("x: is damaged: its checksum is wrong" in text for text in told)
    assert len(told) > 1.75 * len(data)


@pytest.mark.parametrize(
    ("action", "name", "said"),
    [
        (Checkpoint.check, "scene.json", r"scene\.json: is not a checkpoint that this clothfit can read"),
        (lambda file: file.read(3), "scene.json", r"scene\.json: is not a checkpoint that this clothfit can read"),
        (lambda file: file.read(3), "x", "x: there is no such checkpoint to resume from"),
        (Checkpoint.check, "", "it is a folder"),
        (lambda file: file.read(3), "", "is not a file"),
    ],
)
def test_what_is_no_checkpoint_is_neither_read_nor_replaced(tmp_path, action, name, said):
    (tmp_path / "scene.json").write_text("{}")
    with pytest.raises(InvalidInput, match=said):
        action(Checkpoint(tmp_path / name))
    assert (tmp_path / "scene.json").read_text() == "{}"


def test_only_what_this_fit_has_written_is_removed(tmp_path):
    path = tmp_path / "c"
    written(path)
    Checkpoint(path).remove()
    assert path.exists()
    file = Checkpoint(path, identity=SAME)
    file.read(3)
    file.remove()
    assert not path.exists()


IMPOSSIBLE = {
    "another number of parameters": {"best": np.ones(2)},
    "no number": {"start": np.array([1.0, np.nan, 1.0])},
    "no cost": {"cost": np.inf},
    "no width": {"tau": (0.0,)},
    "no width of the best point": {"best_tau": (-1.0,)},
    "no history": {"history": [np.nan]},
    "no row": {"gradient": np.ones((3, 1))},
    "no count": {"beside": -1},
    "no frames": {"window": -1},
    "no end": {"status": "over"},
    "no words": {"warnings": ["\x1b[2J"]},
    "nothing": {"before": None},
    "no model": {"model": "Q"},
    "no letter": {"model": None},
    "no steps": {"substeps": -1},
    "no number of steps": {"substeps": "few"},
}


@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_a_state_that_no_fit_has_is_refused(tmp_path, kind):
    file = written(tmp_path / "c", **IMPOSSIBLE[kind])
    with pytest.raises(InvalidInput, match="c: is not what a fit has written; begin anew, without --resume"):
        file.read(3)


def test_only_a_chosen_model_has_a_number_of_parameters_of_its_own(tmp_path):
    for model in "FRML":
        same(written(tmp_path / "c", model=model).read(4), STATE._replace(model=model))
    with pytest.raises(InvalidInput, match="c: is not what a fit has written"):
        written(tmp_path / "c", model="").read(4)


# --- when it is written


def test_it_is_written_at_once_then_rarely_and_when_asked(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "EVERY", np.inf)
    file, windows = Checkpoint(tmp_path / "c"), []
    for window in range(3):
        file.save(lambda window=window: STATE._replace(window=window))
        windows.append(file.read(3).window)
    file.save(lambda: STATE, now=True)
    assert [*windows, file.read(3).window] == [0, 0, 0, STATE.window]


def test_a_short_fit_writes_nothing(tmp_path):
    file = Checkpoint(tmp_path / "c", after=60.0)
    file.save(lambda: STATE, now=True)
    assert not file.written
    file.save(lambda: STATE._replace(seconds=61.0))
    assert file.written


def test_a_disk_that_is_full_is_a_fault_until_there_is_room(tmp_path, monkeypatch):
    def full(*_):
        raise InvalidInput("no space")

    file = Checkpoint(tmp_path / "c")
    with monkeypatch.context() as patch:
        patch.setattr(module, "write_atomically", full)
        file.save(lambda: STATE, now=True)
        assert (file.fault, file.written) == ("the checkpoint is not up to date: no space", False)
    file.save(lambda: STATE, now=True)
    assert (file.fault, file.written) == ("", True)


# --- fits


GUESS = {"springStiffness": [20.0] * 33, "vertMass": [0.03] * 16}


def noisy(settings, frames, noise):
    """A first guess and a noisy target of the truth."""
    return load(trial(settings, frames, **GUESS)), degrade(record_target(load(trial(settings, frames))), noise, seed=1)


CASES = {
    "auto per spring": ("nL", "auto", 20, None, 1e-3),
    "held by the prior": ("nL", "auto", 20, None, 1e-2),  # its end costs more than a point on the way there
    "auto with a scan": ("nG", "auto", 20, None, 1e-2),
    "windows": ("LL", "gauss-newton", 40, 1.0, 1e-3),
    "hidden truth": ("LL", "gauss-newton", 20, None, None),
    "l-bfgs-b": ("nL", "l-bfgs-b", 10, None, 1e-3),
    "nelder-mead": ("nG", "nelder-mead", 10, 25.0, 1e-3),
}


@functools.cache
def arguments(case):
    """Scene, target, start and method of a case."""
    settings, method, frames, start, noise = CASES[case]
    if noise is None:
        return load(trial(settings, frames)), None, start, method
    return *noisy(settings, frames, noise), start, method


def equal(found, whole):
    """That two fits are the same but for the time they took."""
    for name in ("status", "method", "cost", "rmse", "frames", "evaluations", "parameters", "prior", "warnings"):
        assert getattr(found, name) == getattr(whole, name)
    assert parameters(found.scene).tobytes() == parameters(whole.scene).tobytes()


SAME_COST, SAME_FLOOR = 1e-3, 0.25
"""Relative difference of two costs at the same minimum, and where L-BFGS-B ends: where 50 evaluations gain less than
0.1 %, which on its slow way into the noise is not always at the same cost. Exact fits end below a tolerance.
"""


ENOUGH = {"max_evaluations": 1000, "intervals": False}
"""Evaluations that end none of these fits, resumed or not; intervals come after all that is resumed."""


@functools.cache
def whole_of(case):
    """The fit of a case that nothing interrupts, computed once."""
    return estimate(*arguments(case), **ENOUGH)


def same_minimum(found, whole):
    """That two fits have ended at the same minimum."""
    assert found.status == whole.status
    same = SAME_FLOOR if whole.method == "l-bfgs-b" else SAME_COST
    assert found.cost == pytest.approx(whole.cost, rel=same, abs=1e-10)  # m²: far below what noise leaves


def in_pieces(limits, *given, **options):
    """A fit that is interrupted after so many reports, again and again, then goes on to its end."""
    for count, limit in enumerate([*limits, 10**9]):
        reports = iter(range(limit - 1))

        def report(_progress, reports=reports):
            if next(reports, None) is None:
                raise KeyboardInterrupt

        found = estimate(*given, observer=Watching(progress=report), resume=count > 0, **options)
    return found


@pytest.mark.parametrize("case", CASES)
def test_a_fit_that_is_interrupted_comes_to_the_same_minimum(tmp_path, case):
    """Early, later, at once after it went on, and once more."""
    limits = (2, 9, 2, 4)
    found = in_pieces(limits, *arguments(case), **ENOUGH, checkpoint=tmp_path / "c")
    same_minimum(found, whole_of(case))
    assert found.evaluations >= limits[0]
    assert found.seconds > 0


@pytest.mark.parametrize("case", ["auto per spring", "held by the prior", "windows", "l-bfgs-b"])
def test_every_file_that_a_kill_could_leave_leads_to_the_same_minimum(tmp_path, monkeypatch, case):
    given = arguments(case)
    kept = []
    with monkeypatch.context() as patch:
        patch.setattr(module, "write_atomically", lambda path, data: kept.append(data))
        patch.setattr(module, "EVERY", 0.0)  # at every report
        patch.setattr(module, "WRITING_SHARE", 0.0)
        whole = estimate(*given, **ENOUGH, checkpoint=tmp_path / "c")
    equal(whole, whole_of(case))  # keeping it changes nothing
    assert len(kept) > 5
    for data in [*kept[:: len(kept) // 3], kept[-1]]:
        (tmp_path / "c").write_bytes(data)
        same_minimum(estimate(*given, **ENOUGH, checkpoint=tmp_path / "c", resume=True), whole)


@pytest.mark.parametrize("budget", [30, 50])
def test_a_budget_that_is_spent_gives_its_result_again(tmp_path, budget):
    given = arguments("auto per spring")  # the best point is of a stage before the one that was ended
    short = estimate(*given, max_evaluations=budget, checkpoint=tmp_path / "c", intervals=False)
    assert short.status == "limit"
    equal(estimate(*given, max_evaluations=budget, checkpoint=tmp_path / "c", resume=True, intervals=False), short)


@pytest.mark.parametrize("options", [{"max_evaluations": 2}, {"rmse": 1.0}])
def test_a_resumed_fit_is_never_worse_than_what_it_resumes(tmp_path, options):
    given = arguments("l-bfgs-b")
    whole = estimate(*given, max_evaluations=30, checkpoint=tmp_path / "c")
    found = estimate(*given, **{"max_evaluations": 30, **options}, checkpoint=tmp_path / "c", resume=True)
    assert found.cost == whole.cost


@pytest.mark.parametrize("case", ["auto per spring", "windows", "nelder-mead"])
def test_a_fit_that_had_ended_gives_its_result_without_computing(tmp_path, monkeypatch, case):
    given = arguments(case)
    whole = estimate(*given, max_evaluations=100, checkpoint=tmp_path / "c", intervals=False)
    for of, name in ((Objective, "cost"), (Objective, "cost_and_gradient"), (Trajectory, "model")):
        monkeypatch.setattr(of, name, lambda *_: pytest.fail("it computed"))
    equal(estimate(*given, max_evaluations=100, checkpoint=tmp_path / "c", resume=True, intervals=False), whole)


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """The arguments of a fit that was ended, and its file."""
    scene, file = load(even("nG")), tmp_path_factory.mktemp("fit") / "c"
    given = {"scene": scene, "target": record_target(scene), "start": 2.0, "method": "gauss-newton"}
    estimate(**given, max_evaluations=2, checkpoint=file)
    return given, file


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"method": "bfgs"}, "method: gauss-newton there, bfgs now"),
        ({"start": 3.0}, "start: 2.0 there, 3.0 now"),
        ({"target": np.zeros((20, 16, 3))}, "another target"),
        ({"scene": load_text(json.dumps(even("nG", delta=0.01)))}, "another scene"),
        ({"prior": "none", "loss": "huber"}, "prior: auto there, none now; loss: linear there, huber now"),
        ({"tolerance": 1e-9}, "tolerance: 1e-10 there, 1e-09 now"),
        ({"objective": {"velocity": 2}}, "objective: position there, velocity=2.0 now"),
        ({"model": "G"}, "model: None there, G now"),
        ({"substeps": 2}, "substeps: None there, 2.0 now"),
        ({"keep_step": True}, "keep step: 0.0 there, 1.0 now"),
    ],
)
def test_only_the_same_fit_is_resumed(begun, changes, said):
    given, file = begun
    before = file.read_bytes()
    with pytest.raises(InvalidInput) as caught:
        estimate(**{**given, **changes}, checkpoint=file, resume=True)
    assert str(caught.value).endswith(f"c: belongs to another fit: {said}")
    assert file.read_bytes() == before


@needs_full_disk
def test_a_fit_goes_on_without_room_for_its_checkpoint():
    found = estimate(load(even("nG")), start=2.0, checkpoint="/dev/full")
    assert found.status == "converged"
    assert found.warnings == ["the checkpoint is not up to date: cannot write /dev/full: No space left on device"]


# --- the command


@pytest.fixture
def files(tmp_path):
    """The guess and the target of "auto per spring", as paths."""
    save_motion(arguments("auto per spring")[1], str(tmp_path / "t.npz"))
    return write_scene(tmp_path, trial("nL", **GUESS)), str(tmp_path / "t.npz")


def summary(capsys, *arguments):
    """Exit code, summary and messages of a fit in this process."""
    code = run(["estimate", *arguments, "--json"])
    out, err = capsys.readouterr()
    return code, json.loads(out), err


def test_a_long_fit_keeps_one_beside_its_output_until_it_has_ended(tmp_path, files, capsys, monkeypatch):
    path, target = files
    beside = tmp_path / "scene.fitted.json.checkpoint"
    assert summary(capsys, path, "--target", target, "--max-evaluations", "30")[0] == 5
    assert not beside.exists()  # shorter than a minute
    assert run(["estimate", path, "--target", target, "--resume"]) == 3
    assert "scene.fitted.json.checkpoint: there is no such checkpoint to resume from" in capsys.readouterr().err
    monkeypatch.setattr(checkpoints, "UNASKED_AFTER", 0.0)
    assert summary(capsys, path, "--target", target, "--max-evaluations", "30")[0] == 5
    assert beside.exists()
    assert summary(capsys, path, "--target", target, "--resume")[0] == 0
    assert not beside.exists()


def test_a_fit_in_place_leaves_no_checkpoint_for_a_scene_that_is_gone(files, tmp_path, capsys, monkeypatch):
    path, target = files
    monkeypatch.setattr(checkpoints, "UNASKED_AFTER", 0.0)
    assert summary(capsys, path, "--target", target, "--in-place", "--max-evaluations", "30")[0] == 5
    assert sorted(os.listdir(tmp_path)) == ["scene.json", "t.npz"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--checkpoint", "{scene}"], "--checkpoint: {scene}: must be a file of its own, not an input or the output"),
        (["--checkpoint", "{out}", "-o", "{out}"], "--checkpoint: {out}: must be a file of its own, not an input or"),
        (["--checkpoint", "-"], "--checkpoint: -: must be a file of its own"),
        (["-o", "-", "--resume"], "--resume: the output is no file, so none is kept beside it; name one with"),
    ],
)
def test_places_that_cannot_be_are_refused(tmp_path, options, said, capsys):
    scene = write_scene(tmp_path, even("nG", 5, 3, 3))
    names = {"scene": scene, "out": str(tmp_path / "out")}
    assert run(["estimate", scene, *(option.format(**names) for option in options)]) == 3
    assert capsys.readouterr().err.startswith(f"error: {said.format(**names)}")
    assert os.listdir(tmp_path) == ["scene.json"]


def test_a_file_in_the_place_of_the_default_checkpoint_stays(tmp_path, capsys):
    scene = write_scene(tmp_path, even("nG", 5, 3, 3))
    (tmp_path / "scene.fitted.json.checkpoint").write_text("my notes")
    assert run(["estimate", scene]) == 0
    assert "warning: no checkpoint is kept: " in capsys.readouterr().err
    assert (tmp_path / "scene.fitted.json.checkpoint").read_text() == "my notes"
