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

    from clothfit.base.errors import ClothfitError, InvalidInput, InvalidMotion, InvalidScene
    from clothfit.derivative import verify as verify
    from clothfit.evaluation.evaluate import Evaluation, evaluate
    from clothfit.evaluation.work_precision import WorkPrecision, work_precision
    from clothfit.fit.estimate import estimate
    from clothfit.fit.result import Fit
    from clothfit.formats.convention import Convention, Reading
    from clothfit.inspection.gradient_check import SceneCheck, check_scene
    from clothfit.many.estimate_many import estimate_many
    from clothfit.meshes import mesh as mesh
    from clothfit.meshes import problems
    from clothfit.meshes import weld as weld
    from clothfit.meshes.mesh_file import read_mesh
    from clothfit.meshes.new_scene import new_scene
    from clothfit.motion.degrade import degrade
    from clothfit.motion.divergence import Diverged
    from clothfit.motion.energy import Energy, energies
    from clothfit.motion.files import load_motion, save_motion
    from clothfit.motion.motion import Motion, as_motion
    from clothfit.motion.simulate import simulate
    from clothfit.objective.objective import Objective, cost_and_gradient
    from clothfit.report.page import report_page
    from clothfit.scene.cloth import Cloth
    from clothfit.scene.fit_vector import parameters, with_parameters
    from clothfit.scene.scene import Scene, load, save

    mesh_problems = problems

_HOME = {
    "degrade": "motion.degrade",
    "Convention": "formats.convention",
    "Reading": "formats.convention",
    "Energy": "motion.energy",
    "energies": "motion.energy",
    "ClothfitError": "base.errors",
    "Diverged": "motion.divergence",
    "InvalidInput": "base.errors",
    "InvalidMotion": "base.errors",
    "InvalidScene": "base.errors",
    "Evaluation": "evaluation.evaluate",
    "evaluate": "evaluation.evaluate",
    "Fit": "fit.result",
    "estimate": "fit.estimate",
    "estimate_many": "many.estimate_many",
    "read_mesh": "meshes.mesh_file",
    "new_scene": "meshes.new_scene",
    "Motion": "motion.motion",
    "as_motion": "motion.motion",
    "load_motion": "motion.files",
    "save_motion": "motion.files",
    "simulate": "motion.simulate",
    "Objective": "objective.objective",
    "cost_and_gradient": "objective.objective",
    "WorkPrecision": "evaluation.work_precision",
    "work_precision": "evaluation.work_precision",
    "report_page": "report.page",
    "parameters": "scene.fit_vector",
    "with_parameters": "scene.fit_vector",
    "Cloth": "scene.cloth",
    "Scene": "scene.scene",
    "SceneCheck": "inspection.gradient_check",
    "check_scene": "inspection.gradient_check",
    "load": "scene.scene",
    "save": "scene.scene",
}

# for users as well, by their own names: clothfit.verify.check(…)
_MODULES = {
    "mesh": "meshes.mesh",
    "mesh_problems": "meshes.problems",
    "verify": "derivative.verify",
    "weld": "meshes.weld",
}

__all__ = [
    "Cloth",
    "ClothfitError",
    "Convention",
    "Diverged",
    "Energy",
    "Evaluation",
    "Fit",
    "InvalidInput",
    "InvalidMotion",
    "InvalidScene",
    "Motion",
    "Objective",
    "Reading",
    "Scene",
    "SceneCheck",
    "WorkPrecision",
    "as_motion",
    "check_scene",
    "cost_and_gradient",
    "degrade",
    "energies",
    "estimate",
    "estimate_many",
    "evaluate",
    "load",
    "load_motion",
    "new_scene",
    "parameters",
    "read_mesh",
    "report_page",
    "save",
    "save_motion",
    "simulate",
    "with_parameters",
    "work_precision",
]


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
