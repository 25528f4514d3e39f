"""What a fit is asked to find in place of its scene's flags, and scenes that leave it to the fit."""

import json

import pytest
from helpers.scenes import even, problems

from clothfit.base.errors import InvalidInput
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.flags import auto_flags, modes_of, reflagged
from clothfit.fit.options import Request
from clothfit.scene.scene import dumps, load


def names(scene):
    """The modes of a scene's blocks, by names of kinds."""
    return {block.name: block.mode for block in scene.blocks}


@pytest.mark.parametrize(
    ("asked", "modes"),
    [
        (["wind"], {"wind": "G"}),
        (["stiffness"], {"stiffness": "F"}),
        (["stiffness=r", "damping"], {"stiffness": "R", "damping": "G"}),
        (["nL", "gravity=G"], {"mass": "n", "stiffness": "L", "gravity": "G"}),
        (["path"], {"path": "L"}),
    ],
)
def test_kinds_have_the_mode_that_is_asked_for_or_their_simplest(asked, modes):
    assert modes_of(asked) == modes


@pytest.mark.parametrize("asked", ["wnd", "wind=L", "wind=", "stiffness=Q", "xG"])
def test_what_there_is_not_is_refused(asked):
    with pytest.raises(InvalidInput, match="fit: "):
        modes_of([asked])


def test_what_is_asked_for_takes_the_place_of_the_flags_and_of_auto():
    scene = load(even("GG", fit={"gravity": "G"}))
    assert names(reflagged(scene, Request(fit="wind"))) == {"wind": "G"}
    every = {"stiffness": "M", "damping": "G", "drag": "G", "wind": "G", "gravity": "G"}
    assert names(auto_flags(scene)) == every
    assert names(reflagged(scene, Request(fit="auto"))) == every
    left = load(even("nn", fit="auto"))
    assert names(reflagged(left, Request())) == every
    assert names(reflagged(left, Request(fit=["damping"]))) == {"damping": "G"}
    with pytest.raises(InvalidInput, match="has no friction to fit"):
        reflagged(scene, Request(fit="friction"))


def test_a_scene_may_leave_it_to_the_fit_and_keeps_that_in_its_text():
    scene = load(even("nn", fit="auto"))
    assert scene.auto
    assert not scene.blocks
    assert json.loads(dumps(scene))["fit"] == "auto"
    assert not load(even("nn")).auto
    (problem,) = problems(even("nn", fit="all"))
    assert problem.startswith('fit: "all" is not one of "auto"')


@pytest.mark.slow
def test_a_scene_that_leaves_it_to_the_fit_is_fitted():
    scene = load(even("nn", 20, fit="auto"))
    motion = record_target(load(even("nn", 20, damping=0.4)))
    found = estimate(scene, motion)
    assert found.scene.cloths[0].damping == pytest.approx(0.4, rel=1e-3)  # the target is exact
    assert json.loads(dumps(found.scene))["fit"] == "auto"
