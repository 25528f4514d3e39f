"""Real fabrics: every number has a source and lies in its range; what a command makes of one; comparison in words."""

import json

import pytest
from click.testing import CliRunner

from clothfit import InvalidInput, load
from clothfit.cli.program import group
from clothfit.fabric.fabric import Fabric, fabric_of
from clothfit.fabric.presets import preset, presets, sentence

RANGES = {"density": (0.01, 1.0), "stretch": (1.0, 1e5), "bending": (1e-7, 1e-3)}  # kg/m², N/m, N m, of any cloth


def known(own, what):
    value = getattr(own, what)
    return [each for each in (value if isinstance(value, tuple) else (value,)) if each is not None]


def test_there_are_fabrics_and_their_names_differ():
    names = [each.name for each in presets()]
    assert len(names) == len(set(names)) >= 25


@pytest.mark.parametrize("own", presets(), ids=lambda own: own.name)
def test_each_number_has_a_source_and_is_in_its_range(own):
    for what, (low, high) in RANGES.items():
        values = known(own, what)
        assert bool(values) == (what in own.source)
        least, most = own.ranges.get(what, (low, high))
        assert low <= least
        assert most <= high
        assert all(least <= each <= most for each in values)
        assert len(own.source.get(what, "a source of some length")) > 20


def of(density=0.2, stretch=1000.0, bend=1e-5, curvature=10.0, rest=0.0):
    return Fabric(density, (stretch,) * 3, stretch / 3, (bend,) * 3, (rest,) * 3, curvature)


def test_a_fabric_stands_nearest_to_itself():
    for name in ("denim", "rib-knit", "trousers"):
        own = preset(name)
        said = sentence(Fabric(own.density, own.stretch, 1.0, own.bending, own.bending, 10.0))
        assert said == f"as a fabric it bends like {name} and stretches like {name}" or "any woven" in said


def test_what_is_out_of_range_is_named():
    assert "heavier than 95 %" in sentence(of(density=2.0))
    assert "stiffer in bending" in sentence(of(bend=1e-2))
    assert "limper in bending" in sentence(of(bend=1e-8))
    assert "stretches more than any woven cloth" in sentence(of(stretch=100.0))
    assert "more than any fabric" in sentence(of(stretch=1.0))


def test_what_a_motion_or_a_mesh_does_not_show_is_not_told():
    assert "bend" not in sentence(of(), bends=False)
    assert "bend" not in sentence(of(curvature=2.0))
    assert sentence(of(), bends=False, stretches=False) is None
    assert sentence(of(stretch=9e4), bends=False, sure=0.1).endswith("stretches at most as woven cloth does")
    assert sentence(of(stretch=9e4), bends=False, sure=1e-4) is None


def test_an_unknown_name_is_answered_with_one_that_is_near():
    with pytest.raises(InvalidInput, match="did you mean denim"):
        preset("denmi")


def test_commands_list_fabrics_make_scenes_of_them_and_show_them(tmp_path):
    run = CliRunner().invoke
    listed = json.loads(run(group, ["fabrics", "--json"]).stdout)["fabrics"]
    assert [each["name"] for each in listed] == [each.name for each in presets()]
    path = str(tmp_path / "cloth.json")
    made = run(group, ["new", "plane", "--fabric", "denim", "--size", "0.4", "-o", path])
    assert made.exit_code == 0, made.output
    own, denim = fabric_of(load(path).cloths[0]), preset("denim")
    assert own.density == pytest.approx(denim.density)
    assert own.stretch == pytest.approx(denim.stretch, rel=0.01)
    assert own.bending_at_rest == pytest.approx(denim.bending, rel=0.01)
    shown = json.loads(run(group, ["info", path, "--json"]).stdout)["objects"][0]["fabric"]
    assert shown["stretch"] == pytest.approx(own.stretch)
    both = run(group, ["new", "plane", "--fabric", "denim", "--density", "0.2", "-o", path])
    assert both.exit_code == 0, both.output
    weighed = fabric_of(load(path).cloths[0])
    assert weighed.density == pytest.approx(0.2)
    assert weighed.bending_at_rest == pytest.approx(denim.bending, rel=0.01)
    assert run(group, ["new", "plane", "--fabric", "denim", "--stiffness", "50", "-o", path]).exit_code == 2
