"""How a small difference at the start grows: by known laws, and where a sheet buckles."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import scene_of

from clothfit.motion.simulate import simulate
from clothfit.subspace.sensitivity import growth

pytestmark = pytest.mark.slow  # compiles motions

FRAMES = 40
LOOSE = {"springStiffness": [1e-9] * 23, "dragCoefficient": 0.0, "damping": 0.0, "vertIsFixed": [False] * 12}


def test_in_free_fall_it_stays():
    scene = scene_of(document(cloth(4, 3, **LOOSE)))
    assert growth(scene, simulate(scene, FRAMES)) == pytest.approx(1.0, abs=1e-6)  # what is left of the springs


def test_of_a_cloth_that_hangs_it_decays_and_of_one_that_is_pushed_together_it_grows():
    held = [i < 4 for i in range(12)]
    scene = scene_of(document(cloth(4, 3, damping=2.0, dragCoefficient=0.0, vertIsFixed=held)))
    hanging = growth(scene, simulate(scene, FRAMES))
    upwards = np.array(scene.cloths[0].positions[11] - scene.cloths[0].positions[3])
    turned = replace(scene, gravity=9.81 * upwards / np.linalg.norm(upwards))
    pushed = replace(scene, gravity=-turned.gravity)
    stretched = growth(turned, simulate(turned, FRAMES))
    assert stretched < 1.0
    assert growth(pushed, simulate(pushed, FRAMES)) > 3.0 * max(stretched, hanging)
