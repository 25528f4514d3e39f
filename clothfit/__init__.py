"""clothfit: find the masses and stiffnesses of a mass-spring cloth whose motion matches a target.

The names below are loaded when they are first used, so that `clothfit --help` does not wait for the numerical
libraries.
"""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"

TYPE_CHECKING = False  # what `typing` calls so is true for type checkers only, but takes 10 ms to import
if TYPE_CHECKING:
    from typing import Any

    from clothfit.capture import degrade
    from clothfit.convention import Convention, Reading
    from clothfit.energy import Energy, energies
    from clothfit.errors import ClothfitError, Diverged, InvalidInput, InvalidMotion, InvalidScene
    from clothfit.evaluation import Evaluation, evaluate
    from clothfit.fit import estimate
    from clothfit.fit_vector import parameters, with_parameters
    from clothfit.many import estimate_many
    from clothfit.mesh_file import read_mesh
    from clothfit.motion import Motion, as_motion, simulate
    from clothfit.motion_files import load_motion, save_motion
    from clothfit.objective import Objective, cost_and_gradient
    from clothfit.precision import WorkPrecision, work_precision
    from clothfit.report import report_page
    from clothfit.result import Fit
    from clothfit.scene import Cloth, Scene, load, save
    from clothfit.scene_check import SceneCheck, check_scene
    from clothfit.scene_making import new_scene

_HOME = {
    "degrade": "capture",
    "Convention": "convention",
    "Reading": "convention",
    "Energy": "energy",
    "energies": "energy",
    "ClothfitError": "errors",
    "Diverged": "errors",
    "InvalidInput": "errors",
    "InvalidMotion": "errors",
    "InvalidScene": "errors",
    "Evaluation": "evaluation",
    "evaluate": "evaluation",
    "Fit": "result",
    "estimate": "fit",
    "estimate_many": "many",
    "read_mesh": "mesh_file",
    "new_scene": "scene_making",
    "Motion": "motion",
    "as_motion": "motion",
    "load_motion": "motion_files",
    "save_motion": "motion_files",
    "simulate": "motion",
    "Objective": "objective",
    "cost_and_gradient": "objective",
    "WorkPrecision": "precision",
    "work_precision": "precision",
    "report_page": "report",
    "parameters": "fit_vector",
    "with_parameters": "fit_vector",
    "Cloth": "scene",
    "Scene": "scene",
    "SceneCheck": "scene_check",
    "check_scene": "scene_check",
    "load": "scene",
    "save": "scene",
}

# for users as well, by their own names: clothfit.verify.check(…)
_MODULES = ("mesh", "mesh_problems", "verify", "weld")

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


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"clothfit.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'clothfit' has no attribute {name!r}")
    value = getattr(import_module(f"clothfit.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
