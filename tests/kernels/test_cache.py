"""Compiled code on disk: found again, never wrong, never in the way."""

import os
import shutil
import stat
import subprocess
import sys
import threading
import time

import numba
import pytest
from helpers.scenes import environment

from clothfit.kernels import cache as kernel_cache
from clothfit.kernels import trusted
from clothfit.kernels.cache import KernelCache

pytestmark = pytest.mark.slow  # starts processes

has_owners = pytest.mark.skipif(not hasattr(os, "getuid"), reason="this system's folders have no owners")


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Three folders of our own: of the package (or NUMBA_CACHE_DIR), of the user, the temporary one."""
    made = tuple(tmp_path / name / "kernels-now" for name in ("first", "user", "temporary"))
    for folder in made[1:]:
        folder.parent.mkdir(mode=0o700)
    monkeypatch.setattr(kernel_cache, "folders", lambda: made)
    monkeypatch.setattr(KernelCache, "failed", False)
    monkeypatch.setattr(KernelCache, "used", KernelCache.used)  # put back afterwards
    return made


def block(folder):
    """Have a file stand where a folder is wanted: nothing can be written there, not by root either."""
    if folder.parent.is_dir():
        folder.parent.rmdir()
    folder.parent.write_text("")


# --- which folders


def chosen(monkeypatch, **settings):
    """The folders that are tried with these environment variables; None takes one away."""
    monkeypatch.setattr(kernel_cache.config, "CACHE_DIR", settings.pop("NUMBA_CACHE_DIR", ""))
    for name, value in settings.items():
        monkeypatch.delenv(name, raising=False) if value is None else monkeypatch.setenv(name, value)
    kernel_cache.folders.cache_clear()
    try:
        return kernel_cache.folders()
    finally:
        kernel_cache.folders.cache_clear()


def test_the_package_or_what_the_user_names_comes_first_then_the_user_then_the_temporary_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(kernel_cache.tempfile, "tempdir", str(tmp_path / "tmp"))
    package, user, temporary = chosen(monkeypatch, XDG_CACHE_HOME=str(tmp_path / "own"))
    assert package.parent == kernel_cache.PACKAGE / "__pycache__"
    assert user.parent == tmp_path / "own" / "clothfit"
    assert temporary.parent.parent == tmp_path / "tmp"
    assert len({folder.name for folder in (package, user, temporary)}) == 1
    assert chosen(monkeypatch, NUMBA_CACHE_DIR=str(tmp_path))[0].parent == tmp_path


@pytest.mark.skipif(os.name == "nt", reason="Windows knows the user's folder by itself")
def test_without_a_home_the_user_has_no_folder(monkeypatch):
    monkeypatch.setattr(kernel_cache.os.path, "expanduser", lambda path: path)  # as where nobody has that number
    found = chosen(monkeypatch, XDG_CACHE_HOME=None, LOCALAPPDATA=None)
    assert len(found) == 2
    assert all(folder.is_absolute() for folder in found)


# --- reading and writing


def test_what_is_kept_is_found_again_and_no_other_file_is_there(places):
    assert kernel_cache.save("f-1", b"content") == places[0]
    assert kernel_cache.load("f-1") == (places[0], b"content")
    assert kernel_cache.load("f-2") is None
    assert [path.name for path in places[0].iterdir()] == ["f-1"]


@pytest.mark.parametrize("damage", [lambda d: d[:-1], lambda d: d[:10], lambda d: b"", lambda d: d[:-1] + b"?"])
def test_a_damaged_file_counts_as_absent_and_is_written_anew(places, damage):
    kernel_cache.save("f", b"content")
    path = places[0] / "f"
    path.write_bytes(damage(path.read_bytes()))
    assert kernel_cache.load("f") is None
    kernel_cache.save("f", b"content")
    assert kernel_cache.load("f") == (places[0], b"content")


@pytest.mark.parametrize("blocked", [1, 2])
def test_where_one_folder_cannot_be_written_the_next_one_is(places, blocked):
    for folder in places[:blocked]:
        block(folder)
    assert kernel_cache.save("f", b"content") == places[blocked]
    assert kernel_cache.load("f") == (places[blocked], b"content")


def test_what_an_image_brings_along_is_read_by_users_who_cannot_write_there(places, monkeypatch):
    kernel_cache.save("f", b"from the image")
    write = trusted.Folder.write

    def refused(folder, name, data):
        if folder.path == places[0]:
            raise PermissionError(13, "Permission denied")
        write(folder, name, data)

    monkeypatch.setattr(trusted.Folder, "write", refused)
    assert kernel_cache.load("f") == (places[0], b"from the image")
    assert kernel_cache.save("g", b"new") == places[1]


def test_where_nothing_can_be_written_the_first_reason_is_told(places):
    for folder in places:
        block(folder)
    with pytest.raises(OSError, match="first"):
        kernel_cache.save("f", b"content")


def test_an_interrupted_write_leaves_nothing(places, monkeypatch):
    kernel_cache.save("f", b"content")
    monkeypatch.setattr(trusted.os, "replace", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        kernel_cache.save("g", b"content")
    assert [path.name for path in places[0].iterdir()] == ["f"]


def test_what_a_killed_program_left_goes_after_a_day(places):
    kernel_cache.save("f", b"content")
    for name, age in ((".f.lock", 2.0), (".0123.tmp", 2.0), (".g.lock", 0.5)):
        (places[0] / name).write_bytes(b"")
        then = time.time() - age * kernel_cache.DAY
        os.utime(places[0] / name, (then, then))
    kernel_cache.save("f", b"content")
    assert sorted(path.name for path in places[0].iterdir()) == [".g.lock", "f"]


def test_programs_that_write_at_once_leave_one_whole_file(places):
    contents = [bytes([i]) * 100_000 for i in range(8)]
    threads = [threading.Thread(target=kernel_cache.save, args=("f", content)) for content in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert kernel_cache.load("f")[1] in contents
    assert [path.name for path in places[0].iterdir()] == ["f"]


def linked(folder):
    """Have the folder be elsewhere, with a link in its place."""
    folder.rename(folder.with_name("elsewhere"))
    folder.symlink_to("elsewhere")


only_root = pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="only root can give a folder away")
SPOILT = [lambda folder: folder.chmod(0o777), linked,
          pytest.param(lambda folder: os.chown(folder, 12345, 12345), marks=only_root)]


@has_owners
@pytest.mark.parametrize("spoil", SPOILT, ids=["open to all", "a link", "of somebody else"])
def test_a_folder_that_others_can_change_is_not_trusted(places, spoil):
    block(places[0])
    kernel_cache.save("f", b"content")
    spoil(places[1].parent)
    assert kernel_cache.load("f") is None
    assert kernel_cache.save("f", b"content") == places[2]


@has_owners
@pytest.mark.parametrize("level", [0, 1], ids=["base", "folder"])
def test_a_named_folder_that_everybody_can_write_to_is_left_and_that_is_said(places, monkeypatch, level):
    heard = []
    monkeypatch.setattr(kernel_cache, "warn", heard.append)
    monkeypatch.setattr(kernel_cache.config, "CACHE_DIR", str(places[0].parent))
    kernel_cache._leave_named.cache_clear()
    kernel_cache.save("f", b"content")
    open_to_all = (places[0].parent, places[0])[level]
    open_to_all.chmod(0o777)
    assert kernel_cache.load("f") is None
    assert [kernel_cache.save(name, b"content") for name in "fg"] == [places[1]] * 2
    assert heard == [
        f"NUMBA_CACHE_DIR is not used, as what is in it can run: {open_to_all}: other users can write to it; "
        f"compiled code is kept in {places[1]}"
    ]


@has_owners
def test_a_group_may_share_a_named_folder_and_the_sticky_bit_keeps_a_common_one(places):
    kernel_cache.save("f", b"content")
    places[0].chmod(0o2775)
    places[0].parent.chmod(0o1777)
    assert kernel_cache.load("f") == (places[0], b"content")


@has_owners
def test_the_users_folder_within_one_where_others_can_rename_is_not_trusted(places, tmp_path):
    block(places[0])
    around = tmp_path / "around"
    around.mkdir()
    around.chmod(0o777)
    shutil.move(places[1].parent, around / "user")
    moved = around / "user" / places[1].name
    with pytest.raises(trusted.Untrusted), trusted.made(moved, False, "kernels-", None):
        pass
    around.chmod(0o1777)
    with trusted.made(moved, False, "kernels-", None) as folder:
        assert folder.names() == []


RENAMES = """
import os, sys
mine, theirs = sys.argv[1:]
while True:  # as another user can in a folder of his, or where the sticky bit is missing
    os.rename(theirs, mine)
    os.rename(mine, theirs)
"""


@has_owners
def test_a_folder_of_others_that_is_renamed_in_and_out_is_never_read(places, tmp_path):
    """The check of a path and the reading through it must not be two things: with a look at the path first, some two
    of a hundred loads read what others wrote.
    """
    block(places[0])
    kernel_cache.save("f", b"what others wrote")
    theirs = tmp_path / "theirs"
    places[1].parent.rename(theirs)
    theirs.chmod(0o777)
    call = [sys.executable, "-c", RENAMES, str(places[1].parent), str(theirs)]
    with subprocess.Popen(call) as attacker:
        found = [kernel_cache.load("f") for _ in range(4000)]
        attacker.kill()
    assert attacker.returncode == -9  # it renamed to the end
    assert set(found) == {None}


@has_owners
def test_the_users_folder_is_made_for_the_user_alone(places):
    block(places[0])
    places[1].parent.rmdir()
    kernel_cache.save("f", b"content")
    assert stat.S_IMODE(places[1].parent.stat().st_mode) == 0o700


@pytest.mark.parametrize(("named", "left"), [("", ["kernels-new", "kernels-now"]), ("/named", None)])
def test_folders_of_other_sources_are_removed_when_they_are_old_and_ours(places, monkeypatch, named, left):
    monkeypatch.setattr(kernel_cache.config, "CACHE_DIR", named)
    for name, age in (("kernels-old", 2 * kernel_cache.DAY), ("kernels-new", 0.5 * kernel_cache.DAY)):
        folder = places[0].parent / name
        folder.mkdir(parents=True)
        then = time.time() - age
        os.utime(folder, (then, then))
    kernel_cache.save("f", b"content")
    found = sorted(path.name for path in places[0].parent.iterdir())
    assert found == (left or ["kernels-new", "kernels-now", "kernels-old"])


# --- functions


def compiled(function):
    """The function, compiled as kernels are, and its cache."""
    made = numba.njit(function)
    made._cache = KernelCache(function)
    return made


def doubled(x):
    return x + x


def test_a_function_is_compiled_once_for_each_type(places):
    first, second = compiled(doubled), compiled(doubled)
    for value in (2, 2.5):
        assert first(value) == second(value) == 2 * value
    assert (sum(first.stats.cache_misses.values()), sum(second.stats.cache_misses.values())) == (2, 0)
    assert sum(second.stats.cache_hits.values()) == 2
    assert len(list(places[0].iterdir())) == 2


def test_code_with_classes_that_are_no_more_is_compiled_anew(places):
    compiled(doubled)(2)
    (file,) = places[0].iterdir()
    kernel_cache.save(file.name, b"cclothfit.kernels.cache\nNoSuchClass\n.")  # what pickle looks for by its name
    again = compiled(doubled)
    assert again(2) == 4
    assert sum(again.stats.cache_misses.values()) == 1


def times(k):
    return lambda x: k * x


def test_functions_of_one_name_and_line_are_told_apart_by_what_they_hold(places):
    makers = [compiled(times(k)) for k in (2, 3)]
    assert [maker(5) for maker in makers] == [10, 15]


def test_where_nothing_can_be_kept_it_runs_and_says_so_once(places, monkeypatch):
    heard = []
    monkeypatch.setattr(kernel_cache, "warn", heard.append)
    for folder in places:
        block(folder)
    function = compiled(doubled)
    assert [function(value) for value in (2, 2.5)] == [4, 5.0]
    assert len(heard) == 1
    assert heard[0].startswith(f"compiled code cannot be kept, so every start compiles again: {places[0]}: ")


def test_from_python_that_is_a_warning(places):
    for folder in places:
        block(folder)
    with pytest.warns(RuntimeWarning, match="cannot be kept"):
        kernel_cache._warn("compiled code cannot be kept")


def test_importing_writes_nothing(tmp_path):
    call = [sys.executable, "-c", "import clothfit.fit.estimate, clothfit.evaluation.evaluate"]
    subprocess.run(call, env=environment(NUMBA_CACHE_DIR=str(tmp_path)), check=True)
    assert list(tmp_path.iterdir()) == []


MODULE = """
import sys
import numpy as np
from clothfit.kernels.kernel import kernel

@kernel
def filled(size, value):
    if value < 0:
        raise ValueError("less than nothing")
    return np.full(size, value) + np.arange(size)
"""
CALLS = """
from module import filled
print(filled(3, 2.5).tolist())
for size, value in ((2, -1.0), (-2, 1.0)):
    try:
        filled(size, value)
    except ValueError as error:
        print(error)
import sys
print("numba.cpython.unicode" in sys.modules)
"""


def test_what_is_loaded_runs_as_when_it_was_compiled_faults_and_all_and_loads_no_strings(tmp_path):
    (tmp_path / "module.py").write_text(MODULE)
    where = environment(NUMBA_CACHE_DIR=str(tmp_path / "cache"), PYTHONPATH=os.pathsep.join([str(tmp_path), *sys.path]))
    call = [sys.executable, "-c", CALLS]
    first, again = (subprocess.run(call, env=where, capture_output=True, text=True, check=True) for _ in range(2))
    lines = ["[2.5, 3.5, 4.5]", "less than nothing", "negative dimensions not allowed"]
    assert first.stdout.splitlines()[:3] == again.stdout.splitlines()[:3] == lines
    assert again.stdout.splitlines()[3] == "False"
