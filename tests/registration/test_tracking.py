"""Scans: points that are others in each frame, from files; tracked, compared by their distances, and fitted."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.physics import xyz
from helpers.strangers import sheet

from clothfit import InvalidMotion, cost_and_gradient, evaluate, simulate, with_parameters
from clothfit import load as load_scene
from clothfit.cli.parts.info_records import motion as motion_facts
from clothfit.fit.options import Request
from clothfit.fit.tracked_fit import by_windows, left_behind
from clothfit.formats.animation import normals_at
from clothfit.formats.axes import RIGHT, Reading, facing, from_scene
from clothfit.meshes.mesh import object_document, plane, springs
from clothfit.motion.correspondence import SAME, SCANNED, normals
from clothfit.motion.foreign import load
from clothfit.objective.experiment import Experiment
from clothfit.registration.record import rotation
from clothfit.registration.tracking import placed, tracked
from clothfit.scene.kinds import REST
from clothfit.scene.scene import with_places

FACTOR = 2.0
SCENE = sheet(letters="nF", frames=24)
(CLOTH,) = SCENE.cloths
TRUTH = with_parameters(SCENE, np.array([FACTOR]))
TRIANGLES = CLOTH.triangles.reshape(-1, 3)


@cache
def recorded():
    return simulate(TRUTH, tolerance=1e-12)


def cloud(count=400, noise=0.0, lost=0, strangers=0, motion=None, faces=TRIANGLES):
    """Points on the faces of a motion, others in each frame: `lost` of them, around one, are not there, and
    `strangers` lie anywhere near.
    """
    rng, frames = np.random.default_rng(0), []
    for x in (motion or recorded()).positions:
        chosen = faces[rng.integers(len(faces), size=count)]
        y = np.einsum("mk,mkc->mc", rng.dirichlet([1, 1, 1], count), x[chosen])
        y = y[np.argsort(-np.linalg.norm(y - y[0], axis=1))[: count - lost]]
        y = y + noise * rng.normal(size=y.shape)
        far = rng.uniform(x.min(axis=0) - 0.1, x.max(axis=0) + 0.1, (strangers, 3))
        frames.append(rng.permutation(np.concatenate([y, far])))
    return frames


def as_npz(folder, frames, motion=None, **more):
    """A file with a scan."""
    first, times = np.cumsum([0, *map(len, frames)]), (motion or recorded()).times
    np.savez(folder / "scan.npz", points=np.concatenate(frames), first=first, times=times, **more)
    return folder / "scan.npz"


def as_obj(folder, frames):
    """OBJ files without faces, one point fewer in each."""
    for number, points in enumerate(frames):
        rows = from_scene(points, RIGHT)[number:].tolist()
        (folder / f"scan_{number:03}.obj").write_text("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows))
    return folder / "scan_*.obj"


def as_ply(folder, frames):
    """Binary PLY files."""
    head = "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{}end_header\n"
    for number, points in enumerate(frames):
        rows = from_scene(points, RIGHT)[number:]
        text = head.format(len(rows), "".join(f"property double {c}\n" for c in "xyz"))
        (folder / f"scan_{number:03}.ply").write_bytes(text.encode() + rows.tobytes())
    return folder / "scan_*.ply"


def read(path, **said):
    """The scan of a file."""
    return load(path, SCENE, Reading(**said)).motion


@pytest.mark.slow
def test_points_on_the_surface_have_the_values_of_the_cloth(tmp_path):
    shorter = [y[k:] for k, y in enumerate(cloud())]  # the others leave out as many
    for path in (as_npz(tmp_path, shorter), as_obj(tmp_path, cloud()), as_ply(tmp_path, cloud())):
        found, scan = motion_facts(path), read(path)
        assert (found["scan"], found["frames"], found["points"], found["travel"]) == (True, 24, len(cloud()[0]), None)
        np.testing.assert_array_equal(scan.correspondence.points, read(tmp_path / "scan.npz").correspondence.points)
    fit = estimate(SCENE, scan, start=5.0 * FACTOR, intervals=False)
    assert (fit.correspondence.kind, fit.correspondence.share > 0.95) == ("scan", True)
    assert fit.scene.cloths[0].stiffness == pytest.approx(FACTOR * CLOTH.stiffness, rel=1e-6)  # rounding of 1e-8 m
    assert evaluate(TRUTH, fit.scene, target=scan).fitted.rmse < 1e-7


@pytest.mark.slow
def test_noise_holes_and_strangers_move_a_fit_by_little(tmp_path):
    """2 mm of noise in 24 frames of 320 points leave a factor uncertain by some 0.1 %."""
    scan = read(as_npz(tmp_path, cloud(noise=2e-3, lost=80, strangers=8)))
    fit = estimate(SCENE, scan, start=5.0 * FACTOR)
    assert fit.scene.cloths[0].stiffness == pytest.approx(FACTOR * CLOTH.stiffness, rel=0.01)
    assert fit.verdict.model == "adequate"
    told = json.loads(json.dumps(fit.correspondence.summary()))
    assert 0.95 < told["share"] < 1.0
    assert told["scan_to_cloth"]["median"] == pytest.approx(2e-3 * 0.674, rel=0.1)  # of |noise| along normals
    assert told["cloth_to_scan"]["median"] < 0.05  # half an edge
    assert told["unseen"] == 0.0


def test_vertices_that_are_shuffled_in_each_frame_are_a_scan(tmp_path):
    """Seen by itself, in files of this program and of others; turned about by half a turn in all they are none."""
    rng = np.random.default_rng(0)
    shuffled = np.stack([rng.permutation(x) for x in recorded().positions])
    np.savez(tmp_path / "motion.npz", positions=shuffled, times=recorded().times)
    longer = [np.concatenate([x[:k], x]) for k, x in enumerate(shuffled)]  # `as_obj` leaves out as many
    for path in (tmp_path / "motion.npz", as_obj(tmp_path, longer)):
        found = load(path, SCENE, Reading())
        assert found.motion.correspondence.kind == "scan"
        assert "others in each frame" in " ".join(found.interpretation.notes)
    angles = np.linspace(0.0, np.pi, len(shuffled))
    turned = [x @ rotation(np.array([0.0, each, 0.0])).T for x, each in zip(recorded().positions, angles, strict=True)]
    np.savez(tmp_path / "motion.npz", positions=turned, times=recorded().times)
    assert load(tmp_path / "motion.npz", SCENE, Reading()).motion.correspondence.kind == "same"


@pytest.mark.parametrize("factor", [1.0, 5.0])
def test_vertices_are_tracked_to_where_they_were(tmp_path, factor):
    """With stiffnesses of the scan, to rounding; with five times as large ones, by cloth that keeps its edges."""
    shuffled = [np.random.default_rng(0).permutation(x) for x in recorded().positions]
    own = with_parameters(SCENE, np.array([factor * FACTOR]))
    given = tracked(Experiment(read(as_npz(tmp_path, shuffled), bind="scan"), own)).motion
    away = np.sqrt(((given.positions - recorded().positions) ** 2).sum(axis=2).mean())
    assert away < (1e-6 if factor == 1.0 else 0.02 * np.median(CLOTH.lengths))


@pytest.mark.parametrize("method", ["implicit", "bdf2"])
def test_noise_does_not_shake_a_cloth_that_is_where_the_points_are(tmp_path, method):
    """By the scan's own values the cloth moves freely, with the steps of its scene."""
    own = TRUTH.with_step(TRUTH.delta, TRUTH.frames, method)
    motion = simulate(own, tolerance=1e-12)
    scan = load(as_npz(tmp_path, cloud(noise=2e-3, strangers=8, motion=motion)), own, Reading()).motion
    given = tracked(Experiment(scan, own)).motion
    np.testing.assert_allclose(given.positions, motion.positions, atol=1e-8)  # systems are solved to 1e-10


def test_values_that_are_nearly_right_are_made_right_before_more_frames_follow(tmp_path):
    """A motion may make much of a few thousandths later on. A step of Gauss–Newton leaves about their square."""
    near = with_parameters(SCENE, np.array([1.004 * FACTOR]))
    found, _ = by_windows([near], near, [Experiment(read(as_npz(tmp_path, cloud())), near)], Request())
    assert found.cloths[0].stiffness == pytest.approx(FACTOR * CLOTH.stiffness, rel=1e-7)


@pytest.mark.slow
def test_a_fit_that_chooses_by_itself_tracks_by_few_kinds_where_these_explain_a_scan(tmp_path):
    """Wind and gravity, which are free as well, would take the place of a stiffness that is five times as large."""
    scan = read(as_npz(tmp_path, cloud(noise=2e-3)))
    fit = estimate(with_parameters(SCENE, np.array([5.0 * FACTOR])), scan, fit=("auto",), intervals=False)
    found = simulate(fit.scene.with_step(fit.scene.delta, recorded().positions.shape[0]))
    away = np.sqrt(((found.positions - recorded().positions) ** 2).sum(axis=2).mean())
    assert away < 2e-4  # a tenth of the noise, by 9,600 points
    assert np.array_equal(fit.scene.gravity, SCENE.gravity)
    assert np.array_equal(fit.scene.wind, SCENE.wind)


@pytest.mark.slow
def test_steps_that_end_between_the_frames_of_a_scan_give_way_to_those_that_explain_it(tmp_path):
    """Frames after 1 / 1.2 of the scene's steps: by these the motion differs by more than noise, as steps damp."""
    truth = TRUTH.with_step(TRUTH.delta, TRUTH.frames, "bdf2")
    motion = simulate(truth, tolerance=1e-12)
    scene = with_parameters(truth, np.array([3.0 * FACTOR])).with_step(1.2 * TRUTH.delta, TRUTH.frames)
    scan = load(as_npz(tmp_path, cloud(motion=motion), motion=motion), scene, Reading()).motion
    fit = estimate(scene, scan, intervals=False)
    assert (fit.substeps, fit.scene.delta) == (1, pytest.approx(TRUTH.delta))
    assert fit.scene.cloths[0].stiffness == pytest.approx(FACTOR * CLOTH.stiffness, rel=1e-6)


@pytest.mark.slow
def test_values_far_off_are_found_where_distances_are_rough(tmp_path):
    """A sheet held at two corners buckles as it falls: one minimum of many has a stiffness 16 % and a damping 155 %
    off, from where the truth is downhill, but not for a step of Gauss–Newton.
    """
    mesh = plane(18, 1.0)
    made, held = springs(mesh, 1.0), np.isin(np.arange(len(mesh.positions)), (0, 19))
    cloth = object_document(mesh, held, density=0.18, stiffness=1.0, damping=0.04, drag=0.1, settings="nF")
    stiffness = {"springStiffness": np.where(made.bends, 1.8, 60.0).tolist()}
    document = {
        "title": "sheet", "integrationMethod": 3, "delta": 0.02, "tolerance": 1e-10, "optimizationIterations": 10,
        "forwardSubSteps": 1, "printTimes": False, "windVel": xyz((0.0, 0.0, 0.0)), "colliders": [],
        "objects": [cloth | stiffness],
    }  # fmt: skip
    (made,) = load_scene(document).cloths
    truth = replace(load_scene(document), cloths=(replace(made, fits={"damping": "G"}),))
    motion, faces = simulate(truth, tolerance=1e-10), truth.cloths[0].triangles.reshape(-1, 3)
    path = as_npz(tmp_path, cloud(3000, motion=motion, faces=faces), motion=motion)
    far = with_parameters(truth, np.array([5.0, 0.1]))
    (found,) = by_windows([far], far, [Experiment(load(path, far, Reading()).motion, far)], Request())[0].cloths
    assert found.stiffness == pytest.approx(truth.cloths[0].stiffness, rel=1e-6)
    assert found.damping == pytest.approx(0.04, rel=1e-6)


@pytest.mark.slow
def test_families_come_out_of_a_scan_each_by_itself(tmp_path):
    """From equal factors, far off, though one factor alone cannot bring the cloth to the points."""
    scene = sheet(letters="nR", frames=24)
    truth = with_parameters(scene, np.array([0.5, 3.0, 1.0]))
    scan = load(as_npz(tmp_path, cloud(motion=simulate(truth, tolerance=1e-12))), scene, Reading()).motion
    fit = estimate(scene, scan, start=3.0, intervals=False)
    assert fit.scene.cloths[0].stiffness == pytest.approx(truth.cloths[0].stiffness, rel=1e-4)


@pytest.mark.slow
def test_what_tracking_explains_but_for_noise_is_not_sought_again(tmp_path):
    """Gauss–Newton goes to the minimum: no windows from the start, and no other steps."""
    scene = sheet(letters="nR", frames=24)
    truth = with_parameters(scene, np.array([0.5, 3.0, 1.0]))
    path = as_npz(tmp_path, cloud(noise=1e-3, motion=simulate(truth, tolerance=1e-12)))
    fit = estimate(scene, load(path, scene, Reading()).motion, start=3.0, intervals=False)
    assert (fit.status, len(fit.steps) <= 1, fit.evaluations < 20) == ("converged", True, True)


@pytest.mark.slow
def test_another_fabric_is_fitted_where_it_was_tracked(tmp_path):
    """One that falls another way: the model differs, and vertices end about as near as if they were known."""
    other = replace(TRUTH, gravity=np.array([1.0, -7.0, 0.5]))
    truth = simulate(other)
    shuffled = [np.random.default_rng(0).permutation(x) for x in truth.positions]
    scan = read(as_npz(tmp_path, shuffled), bind="scan")
    errors = []
    for target in (truth, scan):
        fit = estimate(SCENE, target, intervals=False)
        errors.append(evaluate(other, fit.scene, target=truth).fitted.rmse)
    assert 1e-3 < errors[1] < 1.2 * errors[0]


def test_the_gradient_of_distances_is_their_derivative(tmp_path):
    given = tracked(Experiment(read(as_npz(tmp_path, cloud(noise=2e-3))), TRUTH)).motion
    step, made = 1e-5, with_parameters(SCENE, np.array([1.01 * FACTOR]))
    _, gradient = cost_and_gradient(made, given)
    costs = [cost_and_gradient(with_parameters(made, np.array([1.0 + s])), given)[0] for s in (step, -step)]
    assert gradient[0] == pytest.approx((costs[0] - costs[1]) / (2 * step), rel=1e-6)  # errors of the order step²


def test_a_scan_that_there_is_no_time_to_track_is_told(tmp_path):
    fit = estimate(SCENE, read(as_npz(tmp_path, cloud())), time_limit=1e-3)
    assert "untracked" in [hint.code for hint in fit.hints]


def test_held_vertices_that_a_scan_leaves_are_told(tmp_path):
    """All of the scan goes 1 m aside; pins would have to follow it."""
    frames = [y + [0.0, 0.0, k / 23] for k, y in enumerate(cloud())]
    said = {hint.code: hint.text for hint in estimate(SCENE, read(as_npz(tmp_path, frames)), time_limit=1e-3).hints}
    assert "pins-from" in said["held_vertices_move"]
    holes = [y[y[:, 2] > np.median(y[:, 2])] if k % 3 == 1 else y for k, y in enumerate(cloud())]
    for seen in (cloud(), holes):
        assert not left_behind([Experiment(read(as_npz(tmp_path, seen)), SCENE)])


def test_points_with_normals_of_another_side_are_left_out(tmp_path):
    """Half of the points have normals along the cloth: they belong to something else."""
    frames = cloud()
    n, along = normals(CLOTH.positions, TRIANGLES[:1])[0], CLOTH.positions[1] - CLOTH.positions[0]
    sides = np.where(np.arange(sum(map(len, frames)))[:, None] % 2, n, along / np.linalg.norm(along))
    scan = read(as_npz(tmp_path, frames, normals=sides))
    given = tracked(Experiment(scan, SCENE)).motion.correspondence
    assert given.seen[0].mean() == pytest.approx(0.5, abs=0.05)


def test_the_faces_of_a_mesh_in_other_axes_give_the_normals_of_its_points(tmp_path):
    own = {"positions": from_scene(recorded().positions, RIGHT), "triangles": facing(TRIANGLES, RIGHT)}
    np.savez(tmp_path / "mesh.npz", times=recorded().times, **own)
    found = load(tmp_path / "mesh.npz", SCENE, Reading(handedness="right", bind="scan")).motion.correspondence
    np.testing.assert_allclose(found.normals[-1], normals_at(recorded().positions[-1], TRIANGLES), atol=1e-12)


def test_a_mesh_in_another_pose_is_placed_on_the_first_frame(tmp_path):
    """Turned by 20° and moved by 0.3 m; the sheet of the scan has begun to fall. Springs keep their lengths at rest."""
    late = 6
    path = as_npz(tmp_path, cloud()[late:] + cloud()[:late])
    R = rotation(np.array([0.3, -0.1, 0.2]))
    elsewhere = with_places(SCENE, CLOTH.positions @ R.T + [0.3, 0.0, 0.0])
    found = placed(Experiment(load(path, elsewhere, Reading()).motion, elsewhere))
    away = np.linalg.norm(found.cloths[0].positions - recorded().positions[late], axis=1)
    assert np.median(away) < 0.05  # half an edge
    np.testing.assert_allclose(found.cloths[0].rest, CLOTH.rest)
    near = Experiment(read(path), with_places(SCENE, recorded().positions[late]))
    assert placed(near) is near.scene


@pytest.mark.parametrize(("count", "kind"), [(400, SCANNED), (len(CLOTH.mass), SAME)])
def test_one_shape_of_cloth_at_rest_is_a_scan_unless_it_has_the_vertices(tmp_path, count, kind):
    hanging, shape = replace(SCENE, method=REST), recorded().positions[-1] if kind == SAME else cloud(count)[-1]
    rows = from_scene(shape, RIGHT).tolist()
    (tmp_path / "shape.obj").write_text("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows))
    found = load(tmp_path / "shape.obj", hanging, Reading(up="y", handedness="right")).motion.correspondence
    assert found.kind == kind
    assert (found.mesh is not None) == (kind == SCANNED)
    if kind == SCANNED:
        np.testing.assert_allclose(found.points[0], shape, atol=1e-15)  # of numbers that are written in full
        with pytest.raises(InvalidMotion, match="of the points lie more than half an edge"):
            load(tmp_path / "shape.obj", hanging, Reading(up="y", handedness="right", bind="surface"))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"points": np.zeros((4, 2)), "first": [0, 4]}, r"points: has shape \(4, 2\)"),
        ({"points": np.zeros((4, 3)), "first": [0, 5]}, r"first: must be whole numbers that rise from 0 to 4"),
        ({"points": np.zeros((4, 3)), "first": [0, 4], "times": [0.0, 1.0]}, r"times: has shape \(2,\)"),
        ({"points": np.zeros((0, 3)), "first": [0, 0]}, "has no points"),
    ],
)
def test_a_file_that_is_no_scan_is_one_sentence(tmp_path, arrays, message):
    np.savez(tmp_path / "scan.npz", **{key: np.asarray(each) for key, each in arrays.items()})
    with pytest.raises(InvalidMotion, match=message):
        read(tmp_path / "scan.npz")
    with pytest.raises(InvalidMotion):
        load(tmp_path / "scan.npz", None, Reading())
