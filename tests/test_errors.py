"""Every error is in the table of `docs/errors.md`, every row of the table is an error, and each is provoked."""

import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from messages import GAP, pattern, rows, templates
from provoked import COMMANDS, GOOD, PYTHON, SMALL

from clothfit import structure
from clothfit.cli import run
from clothfit.errors import ClothfitError, Diverged
from clothfit.motion import simulate
from clothfit.objective import Objective
from clothfit.scene import load

TESTS = Path(__file__).resolve().parent
ROWS = {row.message: row for row in rows()}
FOREIGN = list(COMMANDS)[:7]  # of the library that reads the command line

ELSEWHERE = {
    "it changed while it was read; try again": "test_faults.py::test_a_file_that_changes_while_it_is_read_is_refused",
    "changed while the fit ran, so it is left as it is; the result is in …":
        "test_faults.py::test_a_scene_that_somebody_saved_meanwhile_is_left_alone",
    "…; then repeat the command with --resume: … is kept":
        "test_faults.py::test_where_the_result_cannot_be_written_the_checkpoint_is_named",
    "is a pipe, which keeps nothing; name a file for the checkpoint":
        "test_faults.py::test_a_pipe_is_no_place_for_a_checkpoint",
    "memory: too little for the balance of momentum; use another method, or allow more":
        "test_storage.py::test_matrices_that_do_not_fit_give_way_with_a_word",
    "out of memory; try fewer frames (optimizationIterations)": "test_job.py::test_all_errors_have_a_sentence",
    "a fault of the program: …: …": "test_job.py::test_all_errors_have_a_sentence",
    "interrupted before there was a result": "test_job.py::test_all_errors_have_a_sentence",
    "this worker has clothfit …, the job comes from …; install one":
        "test_job.py::test_a_job_of_another_version_is_refused",
    "what was compiled could not be kept; name a folder that can be written by NUMBA_CACHE_DIR":
        "test_warmup.py::test_where_it_cannot_keep_anything_it_fails",
    "belongs to another fit: …": "test_checkpoint.py::test_what_differs_is_named",
    "not started": "test_batch.py::test_a_request_to_end_lets_what_runs_end_and_begins_no_more",
    "ended at once, by a second request; nothing is written": "test_batch.py::test_a_second_request_ends_at_once",
    "the process that fitted it died, out of memory or killed":
        "test_many.py::test_a_killed_process_costs_time_only_and_one_that_is_killed_again_is_a_fault",
    "--cluster needs the package distributed: install clothfit[cluster]":
        "test_cluster.py::test_without_dask_the_extra_is_named",
    "--cluster: … is no address of a scheduler; one looks like tcp://host:8786":
        "test_cluster.py::test_where_no_scheduler_is_the_command_ends",
    "--cluster: no scheduler answers at … (…)": "test_cluster.py::test_where_no_scheduler_is_the_command_ends",
    "--cluster: the worker … has …; install …, as here":
        "test_cluster.py::test_a_worker_with_another_version_is_named",
    "every worker that fitted it died, out of memory or killed":
        "test_cluster.py::test_a_job_whose_workers_die_as_often_as_the_scheduler_allows_is_a_fault",
    "the scheduler at … was lost": "test_cluster.py::test_a_scheduler_that_dies_is_told_and_ends_the_run",
    "no steps that fit into the time are short enough for a reference motion; allow more of it (--budget), or fewer "
    "frames (--steps)": "test_richardson.py::test_no_time_and_no_frames_are_refused",
    "no values that were tried gave a simulation that stays finite; nothing is written":
        "test_cli_estimate.py::test_values_that_all_diverge_are_code_4_and_no_file",
    "objects[…] diverged at step … (t = … s); try a smaller delta":
        "test_objective.py::test_a_cost_that_overflows_is_a_divergence",
    "the reference motion is not known well enough to judge by; allow more time (--budget)":
        "test_precision.py::test_frames_count_as_long_as_the_reference_is_known_there",
    "the gradient overflows": "test_errors.py::test_a_gradient_that_overflows_is_a_divergence",
    "a worker of the cluster lacks something: …": "test_errors.py::test_what_a_worker_lacks_is_named",
    "its process died; there was no second try":
        "test_batch.py::test_a_request_to_end_leaves_no_second_try_to_one_that_died",
    "… breaks the rule …": "test_errors.py::test_a_rule_without_words_of_its_own_is_told_as_it_is",
    "error: … m is not possible, it must be above 0 and finite":
        "test_precision.py::test_an_error_that_cannot_be_is_refused",
    "a plane of … divisions, … by … m: nothing can be made of that": "test_mesh.py::test_a_plane_of_nothing_is_refused",
    "… triangles share the edge between vertices … and …; at most 2 can":
        "test_mesh.py::test_an_edge_of_three_triangles_is_refused",
    "vertices … and … need a spring but are at the same place; weld or move them":
        "test_mesh.py::test_a_spring_of_no_length_is_refused",
    "vertex … has no mass, being in no triangle that has an area; remove it":
        "test_mesh.py::test_a_vertex_in_no_triangle_is_refused",
    "fixed: … values for … vertices; one each is needed": "test_mesh.py::test_a_mask_of_another_length_is_refused",
    "derivative check: only … of … steps stand above rounding, … are needed; try another direction, or a point where "
    "the cost curves more": "test_verify.py::test_a_cost_that_does_not_curve_cannot_be_checked",
    "derivative check: direction of shape … given, p has …":
        "test_verify.py::test_a_direction_of_another_shape_is_refused",
    "derivative check: the direction is zero or not finite":
        "test_verify.py::test_a_direction_that_leads_nowhere_is_refused",
    "derivative check: the cost is … near p; a finite one is needed":
        "test_verify.py::test_a_cost_that_is_not_finite_cannot_be_checked",
}  # fmt: skip
"""By message: the test that provokes it, where that takes processes, clusters or the library's own parts."""


def test_every_message_of_the_program_has_a_row_and_every_row_a_message():
    found = templates()
    missing = {text: places for text, places in found.items() if text not in ROWS}
    assert missing == {}, "add them to docs/errors.md, which says how"
    assert set(ROWS) - set(found) == set(FOREIGN)


def test_every_row_is_provoked_once_and_nothing_else_is():
    assert sorted([*COMMANDS, *PYTHON, *ELSEWHERE]) == sorted(ROWS)


@pytest.mark.parametrize("message", ELSEWHERE)
def test_the_tests_that_provoke_the_others_are_there(message):
    file, name = ELSEWHERE[message].split("::")
    assert f"def {name}(" in (TESTS / file).read_text("utf-8")


def filled(folder, files):
    """Write the files of a case."""
    for name, content in {"scene.json": SMALL, "good.npz": GOOD, **files}.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif name.endswith(".npz"):
            np.savez(path, **content)
        else:
            path.write_text(json.dumps(content), encoding="utf-8")


@pytest.mark.parametrize("message", COMMANDS)
def test_a_command_ends_with_the_code_and_the_message_of_its_row(tmp_path, monkeypatch, capsys, message):
    case = COMMANDS[message]
    filled(tmp_path, case.files)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CLOTHFIT_TRACEBACK", raising=False)
    case.prepare(monkeypatch)
    code = run(shlex.split(case.arguments))
    monkeypatch.undo()
    out, err = capsys.readouterr()
    last = err.splitlines()[-1]
    assert (str(code), out) == (ROWS[message].codes, "")
    assert last.startswith("error: ")
    assert pattern(message).search(last)
    assert {name: (tmp_path / name).read_bytes() for name in before} == before  # nothing is written over


@pytest.mark.parametrize("message", PYTHON)
def test_a_call_raises_the_message_of_its_row(message):
    with pytest.raises(ClothfitError) as caught:
        PYTHON[message]()
    assert pattern(message).search(str(caught.value))
    assert str(caught.value.exit_code) == ROWS[message].codes


def test_a_gradient_that_overflows_is_a_divergence(monkeypatch):
    scene = load(SMALL)
    monkeypatch.setattr(Objective, "add_pullback", lambda *arguments: arguments[-1].fill(np.inf))
    with pytest.raises(Diverged, match=r"^scene: the gradient overflows$"):
        Objective(scene, simulate(scene)).cost_and_gradient(np.ones(1))


def test_what_a_worker_lacks_is_named():
    pytest.importorskip("distributed")
    from clothfit.cluster import Cluster

    pool = object.__new__(Cluster)
    pool._results = {0: ModuleNotFoundError("No module named 'numba'")}
    pool._futures = {0: SimpleNamespace(release=lambda: None)}
    outcome = pool.outcome(0)
    assert (outcome.exit_code, outcome.error) == (3, "a worker of the cluster lacks something: No module named 'numba'")


def test_a_rule_without_words_of_its_own_is_told_as_it_is():
    # No rule of today's schema comes here; one that is added to it may, before it has words.
    assert structure._sentence("maximum", 3, 5) == "5 breaks the rule maximum 3"


def test_the_table_names_the_codes_that_the_readme_does():
    readme = (TESTS.parent / "README.md").read_text("utf-8")
    codes = {code for code, _ in re.findall(r"^\| (\d+) \| (.+) \|$", readme, re.MULTILINE)}
    assert {row.codes for row in ROWS.values()} <= codes


def test_no_row_is_a_part_of_words():
    assert all(re.search(r"\w", row.message.replace(GAP, "")) for row in ROWS.values())
