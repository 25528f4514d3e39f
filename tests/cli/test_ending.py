"""`estimate --end-with-input`: another program ends a fit by closing its input, or by ending itself."""

import json
import subprocess
import sys

import pytest
from helpers.scenes import environment, trial, write_scene

from clothfit.scene.scene import load

SECONDS = 100


@pytest.mark.slow  # starts a process
def test_a_fit_ends_with_its_input_and_keeps_the_best(tmp_path):
    path, log = write_scene(tmp_path, trial("LL", 60, 8, 8)), tmp_path / "log.jsonl"
    call = ["estimate", path, "--start", "1", "--rmse", "0", "--max-evaluations", "1000000", "--method", "l-bfgs-b",
            "--prior", "none", "--json", "--log", str(log), "--end-with-input"]  # fmt: skip
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-m", "clothfit", *call], **pipes, env=environment()) as process:
        process.stdin.write(b"what comes on its input is ignored\n")
        process.stdin.flush()
        while not log.exists() or log.read_text("utf-8").count("\n") < 3:
            assert process.poll() is None
        out, err = process.communicate(timeout=SECONDS)  # closes its input
    assert process.returncode == 130, err.decode()
    assert json.loads(out)["status"] == "interrupted"
    assert (load(str(tmp_path / "scene.fitted.json")).cloths[0].stiffness != 1.0).all()
