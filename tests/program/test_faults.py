"""What machines, systems and other people do to a run: files stay whole, the message names the file and the reason."""

import io
import os
import re
import subprocess
import sys
import tempfile
import threading
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.scenes import environment, even, names, needs_full_disk, write_scene

import clothfit
from clothfit.cli.program import run
from clothfit.fit import estimate as fitting

pytestmark = pytest.mark.slow  # starts processes

unix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals, pipes and limits")
NOBODY = 65534
SECONDS = 50


@pytest.fixture
def folder(folder):
    """The folder with a recording of the scene."""
    assert run(["target", "scene.json", "-o", "target.npz", "-q"]) == 0
    return folder


# --- places that cannot be written

def test_where_there_is_no_room_the_old_file_stays_whole(folder, capsys, monkeypatch):
    resource = pytest.importorskip("resource", reason="this system has no limits")

    def filling(*arguments):
        """From here on a file may have 512 bytes: what is met in the middle of writing, as the end of a disk is."""
        resource.setrlimit(resource.RLIMIT_FSIZE, (512, limits[1]))
        return simulated

    simulated, limits = clothfit.simulate(clothfit.load("scene.json")), resource.getrlimit(resource.RLIMIT_FSIZE)
    Path("out.npz").write_bytes(b"old")
    monkeypatch.setattr(clothfit, "simulate", filling)
    try:
        code = run(["simulate", "scene.json", "-q", "-o", "out.npz"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (code, *capsys.readouterr()) == (3, "", "error: cannot write out.npz: File too large\n")
    assert Path("out.npz").read_bytes() == b"old"
    assert names() == ["out.npz", "scene.json", "target.npz"]


@needs_full_disk
@pytest.mark.parametrize("command", ["simulate", "estimate"])
def test_a_full_device_is_named(folder, capsys, command):
    assert run([command, "scene.json", "-q", "-o", "/dev/full"]) == 3
    assert capsys.readouterr().err == "error: cannot write /dev/full: No space left on device\n"


@unix
@pytest.mark.parametrize(("mode", "reason"), [(0o555, "is not writable"), (0o000, "Permission denied")])
def test_a_folder_without_rights_is_told_before_the_work(folder, capsys, monkeypatch, mode, reason):
    monkeypatch.setattr(clothfit, "simulate", lambda *_: pytest.fail("it began to work"))
    with tempfile.TemporaryDirectory() as closed:
        os.chmod(closed, mode)
        root = os.geteuid() == 0
        scene = Path("scene.json").read_text("utf-8")
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(scene.encode())))
        if root:
            os.setresuid(NOBODY, NOBODY, 0)
        try:
            code = run(["simulate", "-", "-o", f"{closed}/x.npz"])
        finally:
            if root:
                os.setresuid(0, 0, 0)
        err = capsys.readouterr().err
        assert (code, err.count("\n")) == (3, 1)
        assert err.startswith(f"error: cannot write {closed}/x.npz: ")
        assert reason in err


def test_where_the_result_cannot_be_written_the_checkpoint_is_named(folder, capsys, monkeypatch):
    Path("out").mkdir()
    command = ["estimate", "scene.json", "--target", "target.npz", "--start", "1", "--checkpoint", "c"]
    command += ["-o", "out/x.json", "-q"]
    fit = fitting.by_request

    def vanishing(*arguments):
        if Path("out").exists():  # a fit may begin with another one
            Path("out").rmdir()
        return fit(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(fitting, "by_request", vanishing)
        assert run(command) == 3
    told = r"error: cannot write out/x.json: .*; then repeat the command with --resume: c is kept\n"
    assert re.fullmatch(told, capsys.readouterr().err)
    Path("out").mkdir()
    assert run([*command, "--resume"]) == 0
    resumed = Path("out/x.json").read_bytes()
    assert run(command) == 0
    assert Path("out/x.json").read_bytes() == resumed


# --- pipes


@unix
def test_scenes_and_motions_come_through_pipes_which_are_no_place_for_a_checkpoint(folder, capsys):
    os.mkfifo("pipe")
    assert run(["estimate", "scene.json", "--checkpoint", "pipe"]) == 3
    assert capsys.readouterr().err == "error: pipe: is a pipe, which keeps nothing; name a file for the checkpoint\n"
    assert names() == ["pipe", "scene.json", "target.npz"]
    for name, pipe in (("scene.json", "scene"), ("target.npz", "target")):
        os.mkfifo(pipe)
        write = partial(Path(pipe).write_bytes, Path(name).read_bytes())
        threading.Thread(target=write, daemon=True).start()
    assert run(["estimate", "scene", "--target", "target", "-q", "-o", "piped.json"]) == 0
    assert run(["estimate", "scene.json", "--target", "target.npz", "-q", "-o", "plain.json"]) == 0
    assert Path("piped.json").read_bytes() == Path("plain.json").read_bytes()


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="this system has no device without end")
@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("simulate /dev/zero -o x", "zero: cannot be read: it has more than the 1 MB that can be read"),
        ("estimate scene.json -o x --target /dev/zero", "zero: cannot be read as .npz or .npy (it is neither)"),
        ("estimate scene.json -o x --start /dev/zero", "zero: cannot be read: it has more than the 1 MB that can be"),
        ("estimate scene.json -o x --resume --checkpoint /dev/zero", "/dev/zero: is not a file, so there is no"),
        ("estimate /dev/zero absent.json -o out/", "/dev/zero: error: zero: cannot be read: it has more than the 1 MB"),
    ],
)
def test_a_device_without_end_is_left(folder, capsys, monkeypatch, command, told):
    monkeypatch.setattr("clothfit.scene.text.MOST_TEXT", 10**6)  # else it takes as long as half a gigabyte does
    monkeypatch.setattr("clothfit.base.npz.MOST_TEXT", 10**6)
    assert run(command.split()) == 3
    assert told in capsys.readouterr().err
    assert set(names()) - {"out"} == {"scene.json", "target.npz"}


# --- inputs that others change


class Growing(io.FileIO):
    """A file to which somebody writes once while it is read."""

    grown = False

    def read(self, size=-1):
        data = super().read(size)
        if not self.grown:
            self.grown = True
            with open(self.name, "ab") as file:
                file.write(b" ")
        return data


@pytest.mark.parametrize("changing", ["scene.json", "target.npz"])
def test_a_file_that_changes_while_it_is_read_is_refused(folder, monkeypatch, capsys, changing):
    def opened(path, mode):
        return Growing(path) if path == changing else open(path, mode)

    monkeypatch.setattr("clothfit.base.reading.open", opened, raising=False)
    assert run(["estimate", "scene.json", "--target", "target.npz"]) == 3
    told = capsys.readouterr().err
    assert told.startswith(f"error: {changing}: cannot be read")
    assert "it changed while it was read; try again" in told
    assert names() == ["scene.json", "target.npz"]


@pytest.mark.parametrize("more", [[], ["--starts", "1", "other.json"]])
def test_a_scene_that_somebody_saved_meanwhile_is_left_alone(folder, monkeypatch, capsys, more):
    scenes = ["scene.json", *[argument for argument in more if argument.endswith(".json")]]
    for name in scenes:
        write_scene(folder, even("nG", 5), name)
    from clothfit.cli.common import output

    before, checked = Path("scene.json").read_bytes(), output.unchanged

    def saved(scene, path):
        Path("scene.json").write_bytes(b"somebody's work")
        return checked(scene, path)

    monkeypatch.setattr(output, "unchanged", saved)
    assert run(["estimate", *scenes, "--in-place", "--jobs", "1", "-q"]) == 3
    told = "changed while the fit ran, so it is left as it is; the result is in scene.fitted.json"
    assert f"scene.json: {told}\n" in capsys.readouterr().err
    assert Path("scene.json").read_bytes() == b"somebody's work"
    Path("same.json").write_bytes(before)
    assert run(["estimate", "same.json", "-q"]) == 0
    assert Path("scene.fitted.json").read_bytes() == Path("same.fitted.json").read_bytes()


# --- memory that is not there, which is refused before any work

FORESEEN = [["simulate", "scene.json"], ["target", "scene.json"], ["evaluate", "scene.json", "scene.json"]]


@pytest.mark.parametrize("command", [*FORESEEN, ["estimate", "scene.json"], ["evaluate", "scene.json", "--speed"]])
def test_memory_that_is_not_free_is_refused_with_the_figure_before_the_work(folder, monkeypatch, capsys, command):
    # the scene can be read
    monkeypatch.setattr("clothfit.scene.text.memory", SimpleNamespace(free=lambda: 10**9))
    monkeypatch.setattr("clothfit.base.memory.ALWAYS_FREE", 0)  # so little is looked at otherwise
    monkeypatch.setattr("clothfit.base.memory.available", lambda: 1000)
    monkeypatch.setattr("clothfit.engine.rollout.run_steps", lambda *_: pytest.fail("it began to work"))
    assert run(command) == 3
    assert ", 1 kB of memory are free; use fewer frames" in capsys.readouterr().err
    assert names() == ["scene.json", "target.npz"]


@pytest.mark.parametrize("command", FORESEEN)
def test_any_number_of_steps_and_any_rate_of_frames_has_its_figure(folder, capsys, command):
    rates = [("--fps", "1e12"), ("--fps", "1e308")] if command[0] == "target" else []
    for option in [("--steps", "100000000"), ("--steps", "9" * 400), *rates]:
        assert run([*command, *option]) == 3
        err = capsys.readouterr().err
        assert "frames of 16 vertices take " in err
        assert len(err) < 200


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere the use of address space is not told")
def test_a_limit_of_the_process_counts(folder):
    # 4 GB of address space, of which the program takes 1; 10^7 frames of 16 vertices take 3.84 GB.
    call = ["sh", "-c", 'ulimit -v 4000000; exec "$0" -m clothfit "$@"', sys.executable]
    call += ["simulate", "scene.json", "--steps", "10000000"]
    done = subprocess.run(call, capture_output=True, env=environment(), check=False, timeout=SECONDS)
    assert (done.returncode, done.stdout) == (3, b"")
    assert b"error: 10000001 frames of 16 vertices take 3.84 GB, " in done.stderr
