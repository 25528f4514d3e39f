"""The public names and their homes. `__init__.py` reads these lines too, and loads a name when it is first used."""

from clothfit.base.errors import ClothfitError as ClothfitError
from clothfit.base.errors import InvalidInput as InvalidInput
from clothfit.base.errors import InvalidMotion as InvalidMotion
from clothfit.base.errors import InvalidScene as InvalidScene
from clothfit.base.version import __version__ as __version__
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
from clothfit.fit.observer import Observer as Observer
from clothfit.fit.options import FitOptions as FitOptions
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

__all__: list[str]
