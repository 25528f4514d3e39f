"""Which faults do the tests find? `python benchmarks/planted_faults.py [--only WORD] [--repo PATH] [--out FILE]`.

Sixty-five faults, each one expression of the package, are planted one at a time into a copy: flipped signs, missing
factors and terms, wrong indices, swapped axes, counts off by one, options that are ignored. The tests that a row of the
table names then run until the first of them fails: path by path, of a folder the quick tests before the slow ones. A
test that fails without the fault as well does not count. Prints for each fault which test found it after how many
seconds, or that none did within `--limit` seconds; `--out` writes the same as JSON. With `--against`, the JSON of an
earlier run, it names the faults that were found then and are not now, and the exit code is 1 where there are any.

`old` stands once in the whole package, so that a fault is found again when a module has been merged or moved; where its
text has changed, its row is to be changed too (`--check` names such rows). Paths of tests that are not there are left
out. No checkout is touched: `--jobs` copies of the package and its tests are worked in.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

import click

COPIED = ("clothfit", "schemas", "tests", "pyproject.toml")
LINKED = ("benchmarks", "docs", "examples", "scripts", "README.md", "CHANGELOG.md", "LICENSE", "Makefile")
FOUND, MISSED, LIMIT, ABSENT = "found", "not found", "not found in time", "text not found once"
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+\.py(?:::.*?)?)(?: - .*)?$", re.MULTILINE)
NOTHING_TO_RUN = 5  # pytest's exit code


class Fault(NamedTuple):
    """What is planted where, and the tests that are asked, first those that are likely to find it."""

    where: str  # where it was when the row was written, and what it is
    old: str
    new: str
    tests: str  # paths below tests/, the module's own first


FAULTS = (
    # forces and their derivatives
    Fault("engine/forces/springs: sign of the damping", "(stretch + beta * dot(d, difference(u",
          "(stretch - beta * dot(d, difference(u", "engine/test_forces.py engine derivative"),
    Fault("engine/forces/springs: factor 2 of a pullback", "mul(ld, fma(bent, sd, add(turn, turn)))",
          "mul(ld, fma(bent, sd, turn))", "engine/test_forces.py derivative engine"),
    Fault("engine/forces/springs: term of a tangent", "swing = rho * t * length + hat * sn - bent * t * sd + beta * wn",
          "swing = rho * t * length + hat * sn - bent * t * sd", "engine/test_forces.py derivative engine"),
    Fault("kernels/fours: numbers of those left over", "a[i + 1] if i + 1 < end else other, a[i + 2]",
          "a[i + 1] if i + 2 < end else other, a[i + 2]", "kernels/test_fours.py"),
    Fault("engine/forces/springs: the last of four", "add_opposite(out, springs, i + 3, s)",
          "add_opposite(out, springs, i + 2, s)", "engine/test_forces.py derivative engine"),
    Fault("engine/forces/wind: mean over the corners", "scaled(scale, n), mul(third, total)", "scaled(scale, n), total",
          "engine/test_forces.py derivative engine"),
    Fault("engine/forces/wind: corner of a gradient", "add_fours(gy, faces, i, end, 1, by_b)",
          "add_fours(gy, faces, i, end, 2, by_b)", "engine/test_forces.py derivative engine"),
    Fault("engine/forces/air: slope of the pressure", "(2.0 * abs(v) - rub) * total - 2.0 * v / sigma * T",
          "(2.0 * abs(v) - rub) * total - v / sigma * T", "engine/test_forces.py derivative engine"),
    Fault("engine/forces/air: friction along the face", "fma(splat((abs(v) - RATIO * omega) * v), unit",
          "fma(splat(abs(v) * v), unit", "engine/test_forces.py engine derivative"),
    Fault("engine/forces/law: sign in a pullback", "pi, by_push = dot(L, Z) - nu",
          "pi, by_push = dot(L, Z) + nu", "engine/test_derivatives.py engine derivative"),
    Fault("engine/forces/collider_rows: transpose of a spin", "stretched(own, by_v, cross(by_v, load3(own, SPIN)))",
          "stretched(own, by_v, cross(load3(own, SPIN), by_v))",
          "engine/test_derivatives.py engine derivative"),
    Fault("engine/forces/spheres: way before the step", "push = h * STIFFNESS * (depth + h * outward)",
          "push = h * STIFFNESS * (depth - h * outward)",
          "engine/test_forces.py engine/test_steps.py derivative engine"),
    Fault("engine/forces/law: sign by the stiffness", "left * by_push - by_depth", "left * by_push + by_depth",
          "engine/test_self_contact.py derivative engine"),
    Fault("engine/forces/law: sign by the load", "by_mu, by_kappa, -rub", "by_mu, by_kappa, rub",
          "engine/test_colliders.py derivative engine"),
    Fault("engine/forces/bodies: swapped weights",
          "return fma(splat(dot(sub(c, a), by_drift)), by_c, mul(splat(dot(sub(b, a), by_drift)), by_b))",
          "return fma(splat(dot(sub(b, a), by_drift)), by_c, mul(splat(dot(sub(c, a), by_drift)), by_b))",
          "engine/test_derivatives.py engine/test_bodies.py engine derivative"),
    # steps, solves, inputs, sweeps
    Fault("engine/step/implicit: part of a shortened step",
          "combine(theta, v_bar, theta * system.h, x_bar, work.w_bar)\n    v_bar[:] = 0.0\n    contact.hand",
          "combine(theta, v_bar, system.h, x_bar, work.w_bar)\n    v_bar[:] = 0.0\n    contact.hand",
          "engine/test_guard.py engine/test_steps.py derivative engine"),
    Fault("engine/step/bdf2: extrapolated velocity", "add(2.0, u_bar, v_bar)", "add(1.0, u_bar, v_bar)",
          "engine/test_steps.py derivative engine"),
    Fault("engine/step/guard: sign of the weight's work", "return not after - work <= (1.0 + SLACK) * before",
          "return not after + work <= (1.0 + SLACK) * before", "engine/test_guard.py engine motion"),
    Fault("engine/solve/sparse: sign of what touches fixed vertices", "store3(sub(load3(out, to), push), out, to)",
          "store3(add(load3(out, to), push), out, to)", "engine/test_self_contact.py derivative engine"),
    Fault("engine/inputs/tables: gradient counted twice", "more = grad.wind[c] - inputs.counted[c]",
          "more = grad.wind[c]", "engine/test_derivatives.py derivative engine"),
    Fault("engine/inputs/tables: inputs a step early", "late = t + inputs.lead\n    if", "late = t\n    if",
          "engine/test_inputs.py engine/test_tape.py engine derivative"),
    Fault("engine/inputs/interpolation: a key's own time",
          'values[np.searchsorted(own, inside, side="right") - 1]',
          'values[np.searchsorted(own, inside, side="left") - 1]',
          "engine/test_inputs.py engine/test_derivatives.py engine scene"),
    Fault("derivative/step_jacobian: sign of the mass", "add(-1.0, w, out.by_mass)",
          "add(1.0, w, out.by_mass)",
          "derivative/test_step_jacobian.py derivative/test_all_kinds.py derivative engine"),
    Fault("derivative/adjoint: first step off by one", "return max(int(acting[0]) - inputs.lead, 0)",
          "return max(int(acting[0]), 0)", "derivative engine/test_inputs.py engine/test_derivatives.py"),
    # costs and fits
    Fault("optimise/gauss_newton: factor 2 of a model", "return -float(2 * self.g @ step + step @ self.H @ step)",
          "return -float(self.g @ step + step @ self.H @ step)", "optimise/test_gauss_newton.py optimise fit"),
    Fault("optimise/gauss_newton: centre of the prior", "model.H + A, model.g + A @ (model.y - prior.centre)",
          "model.H + A, model.g + A @ model.y", "optimise/test_gauss_newton.py optimise fit"),
    Fault("objective/loss: derivative of a loss", 'np.sqrt(1.0 + z if self.name == "soft_l1"',
          'np.sqrt(1.0 + 2.0 * z if self.name == "soft_l1"', "objective/test_comparison.py objective optimise"),
    Fault("objective/comparison: weights left out", "return factor if weights is None else weights * factor",
          "return factor", "objective/test_comparison.py objective optimise"),
    Fault("scene/bounds: bounds of a factor swapped",
          "sorted((ends[0] / float(values.min()), ends[1] / float(values.max())))",
          "sorted((ends[0] / float(values.max()), ends[1] / float(values.min())))",
          "scene/test_factors.py scene optimise/test_coordinates.py optimise fit"),
    Fault("fit/posterior: coverage of intervals", "COVERAGE = 0.95", "COVERAGE = 0.9",
          "fit/test_confidence.py fit/test_sampled.py fit"),
    Fault("fit/holdout: a frame that is kept out", "early, rest = at_frames(motion, slice(first))",
          "early, rest = at_frames(motion, slice(first + 1))", "fit/test_holdout.py fit cli/test_estimate.py"),
    Fault("fit/confidence: nothing is unidentifiable", "flags = np.linalg.norm(known.null, axis=1) > NULL_SHARE",
          "flags = np.linalg.norm(known.null, axis=1) > 2.0", "fit/test_confidence.py fit"),
    Fault("registration/free_fall: inverse rate", "np.sqrt(self.gravity / self.acceleration)",
          "np.sqrt(self.acceleration / self.gravity)", "registration/test_free_fall.py registration fit"),
    Fault("fit/registration: derivative by the rate", "= -t * u, -u / rate", "= -t * u / rate, -u / rate",
          "fit/test_registration.py registration"),
    # scenes, files, meshes
    Fault("scene/factors: exponent's derivative", "inside[self.row] * self.exponent / p[self.column])",
          "inside[self.row] * self.exponent)", "scene/test_factors.py scene"),
    Fault("formats/axes: mirrored z", 'turned[..., 2] = -points[..., 1] if axes.up == "z"',
          'turned[..., 2] = points[..., 1] if axes.up == "z"', "formats/test_every_format.py formats"),
    Fault("formats/mdd: byte order", 'MDD_FLOAT = "<f4", ">f4"', 'MDD_FLOAT = "<f4", "<f4"',
          "formats/test_point_caches.py formats"),
    Fault("formats/c3d: number of frames", "count = found.word(5) - found.word(4) + 1",
          "count = found.word(5) - found.word(4)", "formats/test_markers.py formats"),
    Fault("formats/gltf: tangent of a spline", "self.values[index, 1], span * self.values[index, 2]",
          "self.values[index, 1], span * self.values[index, 0]", "formats/test_glb.py formats"),
    Fault("meshes/mesh: bending of a side", "np.where(bends, share * 2 * each, traction)",
          "np.where(bends, share * each, traction)", "meshes/test_mesh.py meshes"),
    Fault("meshes/problems: parts of joined vertices", "_parts(mesh.parts, number[lot])", "_parts(mesh.parts, number)",
          "meshes/test_problems.py meshes"),
    # motions and what is said of them
    Fault("motion/times: state after a frame", "columns = np.concatenate([step, step[between] + 1])",
          "columns = np.concatenate([step, step[between]])", "motion objective"),
    Fault("motion/energy: velocity of a BDF2 step", "more = 0.5 * (v[late - end :]",
          "more = 1.0 * (v[late - end :]", "motion/test_energy.py motion"),
    Fault("evaluation/evaluate: deviation upside down", "np.abs(found / np.where(usable, true, np.nan) - 1.0)",
          "np.abs(np.where(usable, true, np.nan) / found - 1.0)", "evaluation/test_evaluate.py evaluation"),
    Fault("evaluation/work_precision: error of the reference",
          "if row.cost_and_error[1] + self.reference.error <= error", "if row.cost_and_error[1] <= error",
          "evaluation/test_work_precision.py evaluation"),
    Fault("evaluation/overview: springs of both kinds", "bends = is_bend & (~is_edge | again)",
          "bends = is_bend & ~is_edge", "evaluation/test_overview.py evaluation"),
    # the program
    Fault("cli/fitting/outcomes: exit code of a fit", "return EXIT_CODES[fit.status]", "return 0",
          "cli/test_estimate.py cli"),
    Fault("cli/common/failures: exit code of a wrong value", "3 if value_is_wrong else 2, arguments, error)",
          "2, arguments, error)", "cli/test_refusals.py cli program"),
    Fault("cli/simulate: option left out", "motion, error = moved(scene, frames, tolerance)",
          "motion, error = moved(scene, frames, None)", "cli/test_simulate.py cli"),
    Fault("base/writing: permissions of a file", "os.chmod(file.name, mode & 0o777)",
          "os.chmod(file.name, mode & 0o700)", "base/test_writing.py base"),
    Fault("many/job: range of the starts", "FACTOR ** draw.uniform(-1.0, 1.0)", "FACTOR ** draw.uniform(0.0, 1.0)",
          "many/test_job.py many"),
    Fault("live/commands: default of a command", 'whole(message, "n", 1, 1000, 1)', 'whole(message, "n", 1, 1000, 2)',
          "live"),
    # subspaces and control
    Fault("subspace/frames: normal of a face", "p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0",
          "p1 * q2 - p2 * q1, p0 * q2 - p2 * q0, p0 * q1 - p1 * q0",
          "subspace/test_frames.py subspace/test_players.py subspace"),
    Fault("subspace/network/layers: derivative of ELU", "gh *= np.minimum(h, 0.0) + 1.0", "gh *= np.minimum(h, 0.0)",
          "subspace/network subspace"),
    Fault("subspace/physics/march: entry of a block", "block[j, 4] += weight * D[i, YZ]",
          "block[j, 4] += weight * D[i, XZ]", "subspace/physics subspace"),
    Fault("control/keyframes: average for a centre", 'share = mass[vertices] if ways[0] == "centre"',
          'share = mass[vertices] if ways[0] == "average"', "control/test_keyframes.py control"),
    Fault("control/closed_loop: sign of a change", "gradient[:-1] -= 2.0 * weight * change",
          "gradient[:-1] += 2.0 * weight * change", "control/test_control.py control"),
    # pages and pictures
    Fault("report/packing: rounding", "np.rint(((x - low) / step)[seen])", "np.floor(((x - low) / step)[seen])",
          "report/test_contents.py report/test_page.py report"),
    Fault("report/residuals: frames beyond the fitted ones", "np.nanmean((left[near] ** 2).sum(axis=2), axis=0)",
          "np.nanmean((left ** 2).sum(axis=2), axis=0)", "report/test_contents.py report"),
    Fault("report/findings: half of an interval", "median([high - low for low, high in pairs]) / 2)}",
          "median([high - low for low, high in pairs]))}", "report/test_contents.py report"),
    Fault("pictures/camera: mirrored view", "right = np.array([np.cos(turn), 0.0, -np.sin(turn)])",
          "right = np.array([np.cos(turn), 0.0, np.sin(turn)])", "pictures/test_camera.py pictures"),
    # other tools
    Fault("export/vellum: damping ratio", "0.25 * cloth.damping * np.sqrt(cloth.stiffness * (a + b))",
          "0.5 * cloth.damping * np.sqrt(cloth.stiffness * (a + b))", "export/test_vellum.py export"),
    Fault("export/blender: share of a foot", "found[:, 2] += (1 - foot) * found[:, side]",
          "found[:, 2] += foot * found[:, side]", "export/test_blender.py export"),
    Fault("simulators/substep: world at the end of a substep", "part = (s + 1.0) / model.substeps",
          "part = s / model.substeps", "simulators/test_xpbd.py simulators"),
    Fault("simulators/directions: sign of a mass", "dw = -w if seeds.mass[i] == q else 0.0",
          "dw = w if seeds.mass[i] == q else 0.0", "simulators/test_xpbd.py simulators"),
)


@dataclass
class Result:
    """What became of a fault."""

    fault: str
    ended: str
    found_by: str | None = None
    seconds: float = 0.0
    ran: list[str] = field(default_factory=list)


class Bench:
    """Copies of a package and its tests; one of them stays as it is."""

    def __init__(self, repo: Path, work: Path, jobs: int, limit: float, left_out: str) -> None:
        self.limit, self.left_out = limit, left_out
        self.whole, *self.free = [copied(repo, work / name) for name in ("whole", *(f"job{i}" for i in range(jobs)))]
        self.sound: dict[str, bool] = {}  # whether a test passes without a fault
        self.lock = threading.Lock()

    def judge(self, fault: Fault) -> Result:
        """Plant a fault and run its tests."""
        with self.lock:
            copy = self.free.pop()
        try:
            return self.judge_in(copy, fault)
        finally:
            with self.lock:
                self.free.append(copy)

    def judge_in(self, copy: Path, fault: Fault) -> Result:
        """The same in one of the copies."""
        places = places_of(copy, fault)
        if len(places) != 1:
            return Result(fault.where, ABSENT)
        text = places[0].read_text("utf-8")
        places[0].write_text(text.replace(fault.old, fault.new), "utf-8")
        try:
            return self.asked(copy, fault)
        finally:
            places[0].write_text(text, "utf-8")

    def asked(self, copy: Path, fault: Fault) -> Result:
        """What the tests find in a copy with a fault."""
        result, began, broken = Result(fault.where, MISSED), time.monotonic(), list[str]()
        waiting = parts(copy, fault.tests)
        while waiting:
            paths, marks = waiting[0]
            left = self.limit - (time.monotonic() - began)
            code, output = self.pytest(copy, [*paths, *marks, *(f"--deselect={each}" for each in broken)], left)
            result.seconds = round(time.monotonic() - began, 1)
            result.ran.append(f"{paths[0]} {' '.join(marks[1:])}".strip())
            if code is None:
                result.ended = LIMIT
                return result
            failed = FAILED.search(output)
            if code not in (0, NOTHING_TO_RUN):
                if failed and failed[1] not in broken and not self.passes(failed[1]):
                    broken.append(failed[1])
                    continue
                result.ended, result.found_by = FOUND, failed[1] if failed else output[-500:]
                return result
            waiting.pop(0)
        return result

    def passes(self, test: str) -> bool:
        """Whether a test passes in the copy without a fault."""
        if test not in self.sound:
            self.sound[test] = self.pytest(self.whole, [test], self.limit)[0] == 0
        return self.sound[test]

    def pytest(self, copy: Path, arguments: list[str], seconds: float) -> tuple[int | None, str]:
        """Exit code, None where time ran out, and output of pytest in a copy."""
        own = [*arguments, *(["-k", f"not ({self.left_out})"] if self.left_out else [])]
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-p", "no:cacheprovider", *own]
        process = subprocess.Popen(command, cwd=copy, env=environment(copy), stdout=subprocess.PIPE, text=True,
                                   stderr=subprocess.STDOUT, start_new_session=True)  # fmt: skip
        try:
            output, _ = process.communicate(timeout=max(seconds, 1.0))
            return process.returncode, output
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            if process.poll() is None:  # an interrupt as well
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()


def copied(repo: Path, to: Path) -> Path:
    """Make a folder with the package and the tests of a checkout, and links to what else tests read."""
    to.mkdir(parents=True)
    for name in COPIED:
        (shutil.copytree if (repo / name).is_dir() else shutil.copy2)(repo / name, to / name)
    for name in LINKED:
        if (repo / name).exists():
            (to / name).symlink_to(repo / name)
    shown = [sys.executable, "-c", "import clothfit; print(clothfit.__file__)"]
    used = subprocess.run(shown, cwd=to, env=environment(to), capture_output=True, text=True, check=True).stdout.strip()
    if not Path(used).is_relative_to(to):
        raise click.ClickException(f"{used} would be tested, not {to}")
    return to


def environment(copy: Path) -> dict[str, str]:
    """Variables with which a copy of the package is the one that is imported."""
    return os.environ | {"PYTHONPATH": str(copy)}


def places_of(repo: Path, fault: Fault) -> list[Path]:
    """The files of the package that have the old text, once for each time that they have it."""
    texts = ((path, path.read_text("utf-8")) for path in sorted((repo / "clothfit").rglob("*.py")))
    return [path for path, text in texts for _ in range(text.count(fault.old))]


def parts(copy: Path, tests: str) -> list[tuple[list[str], list[str]]]:
    """The paths and the marks of the runs of pytest, one after the other: what is there of the paths, none twice, of
    folders the quick tests first.
    """
    found: list[tuple[list[str], list[str]]] = []
    before = list[str]()
    for path in (f"tests/{each}" for each in tests.split()):
        if (copy / path).exists():
            paths = [path, *(f"--ignore={each}" for each in before)]
            found += [(paths, ["-m", mark]) for mark in ("quick", "slow")] if (copy / path).is_dir() else [(paths, [])]
            before.append(path)
    return found


def line(result: Result) -> str:
    """What is printed of a fault."""
    if result.found_by:
        return f"{result.seconds:6.1f} s  {result.fault}: {result.found_by}"
    return f"{result.seconds:6.1f} s  {result.fault}: {result.ended.upper()} by {', '.join(result.ran) or 'any test'}"


@click.command()
@click.option("--only", default="", help="Faults whose description has this.")
@click.option("--repo", default=str(Path(__file__).resolve().parent.parent), help="The checkout to take all from.")
@click.option("--jobs", default=1, show_default=True, help="Faults at a time.")
@click.option("--limit", default=240.0, show_default=True, help="Seconds for the tests of a fault.")
@click.option("--left-out", default="test_browser or in_blender", show_default=True, help="Tests that do not run.")
@click.option("--out", type=click.Path(path_type=Path), help="Write the results as JSON.")
@click.option("--against", type=click.Path(exists=True, path_type=Path), help="The JSON of an earlier run.")
@click.option("--check", is_flag=True, help="Only say which texts do not stand once in the package.")
def main(
    only: str, repo: str, jobs: int, limit: float, left_out: str, out: Path | None, against: Path | None, check: bool
) -> None:
    """Plant faults and say which of them the tests find."""
    chosen = [fault for fault in FAULTS if only in fault.where]
    if check:
        wrong = [fault for fault in chosen if len(places_of(Path(repo), fault)) != 1]
        print("\n".join(f"{fault.where}: {fault.old}" for fault in wrong) or f"all {len(chosen)} are there")
        sys.exit(bool(wrong))
    results: list[Result] = []
    with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(jobs) as pool:
        for result in pool.map(Bench(Path(repo), Path(work), jobs, limit, left_out).judge, chosen):
            results.append(result)
            print(line(result), flush=True)
            if out:
                out.write_text(json.dumps([asdict(each) for each in results], indent=1), "utf-8")
    print(f"{sum(each.ended == FOUND for each in results)} of {len(results)} faults found")
    if against:
        found = {each.fault for each in results if each.ended == FOUND}
        lost = [each for each in json.loads(against.read_text("utf-8")) if each["ended"] == FOUND]
        lost = [each for each in lost if only in each["fault"] and each["fault"] not in found]
        print("".join(f"no longer found: {each['fault']} (before: {each['found_by']})\n" for each in lost), end="")
        sys.exit(bool(lost))


if __name__ == "__main__":
    main()
