"""What Blender makes of an exported cloth and of a GLB file, where a Python with Blender (bpy) is at hand.

CLOTHFIT_BPY names such a Python, in an environment of its own (`pip install bpy==4.2.23 'numpy<2'` for Python 3.11).
"""

import importlib.util
import os
import sys

import numpy as np
import pytest
from helpers.paths import ROOT

import clothfit
from clothfit.formats.axes import from_scene

pytestmark = pytest.mark.slow  # starts a process


@pytest.fixture(scope="module")
def benchmark():
    """The benchmark, as a module."""
    spec = importlib.util.spec_from_file_location("blender_benchmark", ROOT / "benchmarks" / "blender.py")
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


# The bounds are those of the benchmark's docs: other models of cloth, after a fifth of a second and half of one.
@pytest.mark.parametrize("name", ["light", "corners"])
def test_a_cloth_falls_in_blender_as_here(benchmark, tmp_path, name):
    python = os.environ.get("CLOTHFIT_BPY", sys.executable)
    if not benchmark.has_blender(python):
        pytest.skip("no Blender as a Python module; name a Python that has one by CLOTHFIT_BPY")
    scene = benchmark.CLOTHS[name]()
    motion = clothfit.simulate(scene)
    jobs = benchmark.jobs_of(scene, motion, tmp_path, name)
    jobs[0]["frames"] = 26
    cloth, file = benchmark.played(python, jobs, tmp_path)
    truth = from_scene(motion.positions, benchmark.BLENDERS)
    assert np.isfinite(cloth).all()
    for frame in (10, 25):
        assert benchmark.rms(cloth[frame] - truth[frame]) < 0.15 * benchmark.rms(truth[frame] - truth[0])
    assert np.linalg.norm(file - truth, axis=2).max() < 1e-5 + 4e-7  # of float32 numbers up to 4 m
