"""clothfit: find the masses and stiffnesses of a mass-spring cloth whose motion matches a target.

The names below are loaded when they are first used, so that `clothfit --help` does not wait for the numerical
libraries.
"""

from __future__ import annotations

from importlib import import_module

from clothfit.base.version import __version__ as __version__

TYPE_CHECKING = False  # what `typing` calls so is true for type checkers only, but takes 10 ms to import
if TYPE_CHECKING:
    from typing import Any

    from clothfit.base.errors import ClothfitError as ClothfitError
    from clothfit.base.errors import InvalidInput as InvalidInput
    from clothfit.base.errors import InvalidMotion as InvalidMotion
    from clothfit.base.errors import InvalidScene as InvalidScene
    from clothfit.control.closed_loop import Costs as Costs
    from clothfit.control.control import Control as Control
    from clothfit.control.control import find_controls as find_controls
    from clothfit.control.control import find_forces as find_forces
    from clothfit.control.controls import Controls as Controls
    from clothfit.control.controls import Handle as Handle
    from clothfit.control.keyframes import Key as Key
    from clothfit.control.keyframes import load_keys as load_keys
    from clothfit.derivative import verify as verify
    from clothfit.evaluation.evaluate import Evaluation as Evaluation
    from clothfit.evaluation.evaluate import evaluate as evaluate
    from clothfit.evaluation.gradient_check import SceneCheck as SceneCheck
    from clothfit.evaluation.gradient_check import check_scene as check_scene
    from clothfit.evaluation.work_precision import WorkPrecision as WorkPrecision
    from clothfit.evaluation.work_precision import work_precision as work_precision
    from clothfit.fit.estimate import estimate as estimate
    from clothfit.fit.result import Fit as Fit
    from clothfit.formats.axes import Convention as Convention
    from clothfit.formats.axes import Reading as Reading
    from clothfit.live.client import connect as connect
    from clothfit.live.engine import Engine as Engine
    from clothfit.many.estimate_many import estimate_many as estimate_many
    from clothfit.meshes import mesh as mesh
    from clothfit.meshes import problems
    from clothfit.meshes.mesh import read_mesh as read_mesh
    from clothfit.meshes.new_scene import new_scene as new_scene
    from clothfit.motion.degrade import degrade as degrade
    from clothfit.motion.divergence import Diverged as Diverged
    from clothfit.motion.energy import Energy as Energy
    from clothfit.motion.energy import energies as energies
    from clothfit.motion.files import load_motion as load_motion
    from clothfit.motion.files import save_motion as save_motion
    from clothfit.motion.motion import Motion as Motion
    from clothfit.motion.motion import as_motion as as_motion
    from clothfit.motion.simulate import simulate as simulate
    from clothfit.objective.differentiable import Objective as Objective
    from clothfit.objective.objective import cost_and_gradient as cost_and_gradient
    from clothfit.objective.own_cost import Residuals as Residuals
    from clothfit.report.page import report_page as report_page
    from clothfit.scene.cloth import Cloth as Cloth
    from clothfit.scene.fit_vector import parameters as parameters
    from clothfit.scene.fit_vector import with_parameters as with_parameters
    from clothfit.scene.forces import Forces as Forces
    from clothfit.scene.forces import load_forces as load_forces
    from clothfit.scene.forces import save_forces as save_forces
    from clothfit.scene.scene import Scene as Scene
    from clothfit.scene.scene import load as load
    from clothfit.scene.scene import save as save

    mesh_problems = weld = problems

_HOMES = {
    "base.errors": ("ClothfitError", "InvalidInput", "InvalidMotion", "InvalidScene"),
    "scene.cloth": ("Cloth",),
    "scene.fit_vector": ("parameters", "with_parameters"),
    "scene.forces": ("Forces", "load_forces", "save_forces"),
    "scene.scene": ("Scene", "load", "save"),
    "formats.axes": ("Convention", "Reading"),
    "meshes.mesh": ("read_mesh",),
    "meshes.new_scene": ("new_scene",),
    "motion.degrade": ("degrade",),
    "motion.divergence": ("Diverged",),
    "motion.energy": ("Energy", "energies"),
    "motion.files": ("load_motion", "save_motion"),
    "motion.motion": ("Motion", "as_motion"),
    "motion.simulate": ("simulate",),
    "objective.differentiable": ("Objective",),
    "objective.objective": ("cost_and_gradient",),
    "objective.own_cost": ("Residuals",),
    "fit.estimate": ("estimate",),
    "fit.result": ("Fit",),
    "control.closed_loop": ("Costs",),
    "control.control": ("Control", "find_controls", "find_forces"),
    "control.controls": ("Controls", "Handle"),
    "control.keyframes": ("Key", "load_keys"),
    "evaluation.evaluate": ("Evaluation", "evaluate"),
    "evaluation.gradient_check": ("SceneCheck", "check_scene"),
    "evaluation.work_precision": ("WorkPrecision", "work_precision"),
    "many.estimate_many": ("estimate_many",),
    "report.page": ("report_page",),
    "live.client": ("connect",),
    "live.engine": ("Engine",),
}
"""Modules to the public names that they have."""

_HOME = {name: module for module, names in _HOMES.items() for name in names}

_MODULES = {  # for users as well, by their own names: clothfit.verify.check(…)
    "mesh": "meshes.mesh", "mesh_problems": "meshes.problems", "verify": "derivative.verify", "weld": "meshes.problems",
}  # fmt: skip

__all__ = sorted([*_HOME, *_MODULES])


if not TYPE_CHECKING:  # to them it would be an attribute for every name, of no type

    def __getattr__(name: str) -> Any:
        if name in _MODULES:
            return import_module(f"clothfit.{_MODULES[name]}")
        if name not in _HOME:
            raise AttributeError(f"module 'clothfit' has no attribute {name!r}")
        value = getattr(import_module(f"clothfit.{_HOME[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
