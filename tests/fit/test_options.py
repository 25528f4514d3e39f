"""The keyword arguments of a fit: those of the command, and motions given by their paths."""

import inspect
import math
from dataclasses import fields

import click
import numpy as np
import pytest
from helpers.fits import estimate, estimate_many
from helpers.scenes import even

import clothfit
from clothfit import Reading, load
from clothfit.cli import estimate as command
from clothfit.fit.options import FitOptions, Request, requested

ARGUMENTS = inspect.signature(clothfit.estimate).parameters
FIELDS = {each.name: each for each in fields(FitOptions)}

FILES = {"output", "report", "in_place", "log", "plot", "gif", "cache"}
"""Options that say what is written, which a caller does with the result."""

OF_THE_COMMAND = {
    "help_all", "json", "version", "quiet", "verbose", "help", "watch", "forces", "end_with_input", "set",
}  # fmt: skip
"""What a caller asks for otherwise: forces belong to the scene (`Scene.with_forces`)."""
SIMULATORS = {"simulator", "iterations", "bends_by", "blender"}
"""Options of fits in the model of another tool, which functions of their own do."""
READING = {"fps", "frames", "scale", "up", "handedness", "map", "bind", "cloth"}
MANY = {"starts", "seed", "jobs", "cluster"}


def options():
    """The options and settings of the command, by their names in Python."""
    made = command.command
    listed = [each for each in made.get_params(click.Context(made)) if isinstance(each, click.Option)]
    return {each.opts[-1].lstrip("-").replace("-", "_"): each for each in listed}


@pytest.fixture(scope="module")
def scene():
    return clothfit.load(even("nG", 6, 3, 3))


def test_every_option_of_a_fit_is_an_argument_or_a_field_of_its_name():
    own = set(options()) - FILES - OF_THE_COMMAND - SIMULATORS - READING - MANY
    assert own - {"budget"} == {*FIELDS, *ARGUMENTS} - {"scene", "options", "observer", "time_limit"}
    assert len(ARGUMENTS) <= 8


def test_what_tunes_a_fit_is_a_setting():
    settings = set(command.command.settings)
    assert settings & set(FIELDS) == set(FIELDS) - {  # which are options
        "holdout", "fit_time", "fit_placement", "fit_scale", "hold", "fit", "bounds", "substeps", "keep_step", "resume",
    }


def test_the_options_of_files_and_of_many_fits_are_arguments_too():
    many = inspect.signature(clothfit.estimate_many).parameters
    assert set(many) >= MANY
    of_reading = {option.name for name, option in options().items() if name in READING}
    assert of_reading == set(inspect.signature(Reading).parameters)


def test_their_defaults_mean_the_same():
    compared = []
    for name, option in options().items():
        if name in FIELDS and isinstance(option.default, (str, int, float)):
            assert option.default == FIELDS[name].default, name
            compared.append(name)
    assert {"prior", "loss", "max_evaluations", "holdout_of", "intervals"} <= set(compared)
    assert requested(FitOptions()) == Request()


def test_the_words_of_options_are_what_was_given():
    given = FitOptions(loss="huber", fit="wind", holdout=0.2)
    assert repr(given) == "FitOptions(loss='huber', holdout=0.2, fit=('wind',))"
    assert FitOptions(fit=["nR", "wind"]).fit == ("nR", "wind")
    with pytest.raises(clothfit.InvalidInput, match="fit: auto chooses what to fit by itself"):
        FitOptions(fit=["auto", "wind"])
    with pytest.raises(clothfit.InvalidInput, match="options: FitOptions are needed, not a dict"):
        requested({"loss": "huber"})


@pytest.mark.parametrize(("given", "seconds"), [("2m", 120.0), (9, 9), (0.5, 0.5), (None, None)])
def test_a_time_limit_is_a_time(given, seconds):
    assert requested(FitOptions(), time_limit=given).time_limit == seconds


WITHOUT = {"target": None}
REFUSED = [  # the flags of masses and stiffnesses and what else is fitted, arguments of `estimate`, what is said
    ("nL", {}, {"time_limit": "soon"}, "time_limit: 'soon' is no time above 0"),
    ("nL", {}, {"model": "Q"}, "model: there is no 'Q'; use auto, F, G, R, M, L"),
    ("nL", {}, {"method": "newton"}, "there is no 'newton'; use auto, momentum, gauss-newton, l-bfgs-b"),
    ("nL", {}, {"max_evaluations": 0}, "max_evaluations: 0 evaluations are too few"),
    ("nL", {}, {"substeps": 0}, "substeps must be auto or a whole number from 1 on; 0 was given"),
    ("nL", {}, {"substeps": 1.5}, "substeps must be auto"),
    ("nL", {}, {"substeps": "many"}, "substeps must be auto"),
    ("nL", {}, {"substeps": "auto", "keep_step": True}, "substeps: the step is to be kept; use either substeps or"),
    ("nL", {}, {"windows": 1}, "windows must have 2 frames or more; 1 was given"),
    ("nL", {}, {"windows": 5, "fit_time": True}, "windows: they begin in the target's own states"),
    ("nL", {}, {"windows": 5, **WITHOUT}, "windows: a target is needed"),
    ("nL", {}, {"resume": True}, "resume: a checkpoint is needed"),
    ("nL", {}, {"fit_time": True, **WITHOUT}, "can be found only where one is given; give a target"),
    ("nL", {}, {"holdout": 0.0}, "holdout must be a fraction above 0 and below 1; 0 was given"),
    ("nL", {}, {"holdout": 1.0}, "holdout must be a fraction above 0 and below 1; 1 was given"),
    ("nL", {}, {"holdout": math.nan}, "holdout must be a fraction above 0 and below 1; nan was given"),
    ("nL", {}, {"holdout": 0.2, "holdout_of": "springs"}, "holdout: there is nothing called 'springs'"),
    ("nn", {}, WITHOUT, "nothing to fit: no object flags anything; use --fit auto or --fit nF, or set"),
    ("nL", {}, {"start": 20000.0}, "start: 20000 is not within the bounds"),
    ("nL", {}, {"start": math.inf}, "start: inf is not within the bounds"),
    ("nL", {}, {"start": [1.0] * 15 + [1e5]}, "start: 100000 is not within the bounds"),
    ("nL", {}, {"start": [1.0] * 15}, "start: 15 values given, .* has 16 parameters"),
    ("nL", {}, {"start": np.ones((16, 1))}, "start: 16 values given"),
    ("nL", {}, {"start": []}, "start: 0 values given"),
    ("nL", {}, {"start": load(even("nL"))}, r"objects\[0\] has 33 values of stiffness, 16 are needed"),
    ("nn", {"damping": "G"}, {"start": -1.0}, "start: -1 is not within the bounds 0 … 10000"),
    ("nn", {"springRestLength": "G"}, {"start": 0.0}, "start: 0 is not within the bounds 0.0001 … 10000"),
    ("nn", {"gravity": True}, {"start": [0.0, -2e4, 0.0]}, "start: -20000 is not within the bounds"),
    ("nn", {"windVel": True}, {"start": math.nan}, "start: nan is not within the bounds -10000 … 10000"),
]


@pytest.mark.slow  # a start is looked at after the target
@pytest.mark.parametrize(("letters", "fit", "given", "text"), REFUSED)
def test_what_cannot_be_is_refused(letters, fit, given, text):
    made = even(letters, 6, 3, 3)
    (made if {"gravity", "windVel"} & set(fit) else made["objects"][0])["fit"] = fit
    own = load(made)
    target = clothfit.simulate(own)
    with pytest.raises(clothfit.InvalidInput, match=text):
        estimate(own, **{"target": target, **given})


def test_many_fits_have_no_checkpoint(scene):
    with pytest.raises(clothfit.InvalidInput, match="checkpoint: is for one fit, not for many"):
        estimate_many([scene], checkpoint="x")


@pytest.fixture(scope="module")
def files(scene, tmp_path_factory):
    """The motion of the scene, and files of it: one of this program, one of another."""
    folder = tmp_path_factory.mktemp("motions")
    motion = clothfit.simulate(scene, tolerance=1e-10)
    for suffix in ("npz", "pc2"):
        clothfit.save_motion(motion, folder / f"target.{suffix}", scene)
    return motion, folder


@pytest.mark.slow  # compiles a fit
def test_a_target_may_be_the_path_of_any_motion_file(scene, files):
    motion, folder = files
    guess = clothfit.with_parameters(scene, 1.5 * clothfit.parameters(scene))
    by_motion = estimate(guess, motion, max_evaluations=40)
    by_path = estimate(guess, folder / "target.npz", max_evaluations=40)
    assert by_path.cost == by_motion.cost
    np.testing.assert_array_equal(clothfit.parameters(by_path.scene), clothfit.parameters(by_motion.scene))
    pair = estimate(guess, [str(folder / "target.pc2"), (folder / "target.npz", scene)], max_evaluations=40)
    assert pair.frames == 2 * scene.frames
    assert clothfit.parameters(pair.scene) == pytest.approx(clothfit.parameters(scene), rel=1e-3)  # float32 of a cache


@pytest.mark.slow  # compiles a fit
def test_costs_evaluations_and_pages_take_a_path_as_well(scene, files):
    path = str(files[1] / "target.npz")
    motion = clothfit.load_motion(path, scene)
    guess = clothfit.with_parameters(scene, 1.5 * clothfit.parameters(scene))
    assert clothfit.cost_and_gradient(guess, path)[0] == clothfit.cost_and_gradient(guess, motion)[0]
    by_path, by_motion = (clothfit.evaluate(scene, guess, horizon=9, target=each) for each in (path, motion))
    assert by_path == by_motion
    assert by_path.fitted.rmse > 0
    assert clothfit.report_page(scene, guess, path, frames=6) == clothfit.report_page(scene, guess, motion, frames=6)


def test_a_start_may_be_the_path_of_a_scene(scene, tmp_path):
    guess = clothfit.with_parameters(scene, 1.5 * clothfit.parameters(scene))
    clothfit.save(guess, tmp_path / "guess.json")
    motion = clothfit.simulate(scene)
    options = {"max_evaluations": 2, "method": "l-bfgs-b", "intervals": False}
    by_path, by_scene = (estimate(scene, motion, one, **options) for one in (tmp_path / "guess.json", guess))
    assert by_path.cost == by_scene.cost > 0
    with pytest.raises(clothfit.InvalidScene, match=r"nothing\.json: there is no such file"):
        estimate(scene, motion, "nothing.json")


OF_A_MOTION = [clothfit.degrade, lambda path: clothfit.save_motion(path, "other.npz"),
               lambda path: clothfit.energies(clothfit.load(even("nG", 6, 3, 3)), path)]  # fmt: skip
OF_A_SCENE = [clothfit.simulate, clothfit.estimate, clothfit.parameters, lambda path: clothfit.evaluate(path, path),
              lambda path: clothfit.energies(path, None), lambda path: clothfit.Objective(path, None)]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "path", "remedy"),
    [*((call, "a.npz", r"load_motion\('a\.npz', scene\)") for call in OF_A_MOTION),
     *((call, "a.json", r"load\('a\.json'\)") for call in OF_A_SCENE)],
)  # fmt: skip
def test_a_path_given_for_a_motion_elsewhere_or_for_a_scene_says_how_to_load_it(call, path, remedy):
    with pytest.raises(clothfit.InvalidInput, match=rf"load it: clothfit\.{remedy}"):
        call(path)
