"""Files appear whole or not at all, whatever goes wrong on the way."""

import os
import stat
import threading
from unittest.mock import Mock

import pytest

from clothfit.base import writing as output
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import check_writable, write_atomically


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_a_new_file_has_the_data_and_the_permissions_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "new.txt", b"data\r\n")
    finally:
        os.umask(before)
    assert (tmp_path / "new.txt").read_bytes() == b"data\r\n"
    assert mode_of(tmp_path / "new.txt") == 0o640
    assert os.listdir(tmp_path) == ["new.txt"]


def test_an_existing_file_keeps_its_permissions(tmp_path):
    path = tmp_path / "old.txt"
    path.write_bytes(b"old")
    path.chmod(0o606)
    for possible in (path, tmp_path / "new.txt", os.devnull):
        check_writable(possible)
    assert os.listdir(tmp_path) == ["old.txt"]
    write_atomically(str(path), b"new")
    assert (path.read_bytes(), mode_of(path)) == (b"new", 0o606)


@pytest.mark.parametrize("exists", [True, False])
def test_a_link_stays_and_its_target_is_written(tmp_path, exists):
    (tmp_path / "folder").mkdir()
    target = tmp_path / "folder" / "target.txt"
    for _ in range(exists):
        target.write_bytes(b"old")
    (tmp_path / "link.txt").symlink_to(os.path.join("folder", "target.txt"))
    write_atomically(tmp_path / "link.txt", b"new")
    assert (tmp_path / "link.txt").is_symlink()
    assert target.read_bytes() == b"new"
    assert os.listdir(tmp_path / "folder") == ["target.txt"]


@pytest.mark.parametrize("step", ["fsync", "replace", "chmod"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file_and_no_other(tmp_path, monkeypatch, step, error):
    path = tmp_path / "old.txt"
    path.write_bytes(b"old")
    monkeypatch.setattr(output.os, step, Mock(side_effect=error))
    with pytest.raises((InvalidInput, KeyboardInterrupt)) as caught:
        write_atomically(path, b"new")
    monkeypatch.undo()
    expected = {OSError: f"cannot write {path}: No space left on device", KeyboardInterrupt: ""}
    assert str(caught.value) == expected[type(error)]
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["old.txt"]


@pytest.mark.parametrize("function", [check_writable, lambda path: write_atomically(path, b"data")])
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("", "it is a folder"),
        ("absent/out.txt", "the folder .*absent does not exist"),
        ("absent/", "it does not name a file"),
        ("file.txt/out.txt", "Not a directory"),
        ("loop", "symbolic links"),
        ("n" * 300, "too long"),
        ("null\0.txt", "null"),
    ],
)
def test_a_path_that_cannot_be_written_is_refused_with_the_reason(tmp_path, function, name, reason):
    (tmp_path / "file.txt").write_bytes(b"old")
    (tmp_path / "loop").symlink_to("loop")
    path = os.path.join(tmp_path, name)
    with pytest.raises(InvalidInput, match=f"^cannot write .*: .*{reason}"):
        function(path)
    assert sorted(os.listdir(tmp_path)) == ["file.txt", "loop"]


@pytest.mark.parametrize(("refused", "reason"), [("out.txt", "not writable"), ("", "the folder .* is not writable")])
def test_what_is_read_only_is_refused(tmp_path, monkeypatch, refused, reason):
    path = tmp_path / "out.txt"
    path.write_bytes(b"old")
    # A test run by root may write everywhere; the answer of the system is played instead.
    monkeypatch.setattr(
        output.os, "access", lambda asked, _: os.fspath(asked) != os.path.join(tmp_path, refused).rstrip("/")
    )
    with pytest.raises(InvalidInput, match=reason):
        check_writable(path)


def test_a_pipe_is_written_and_stays_a_pipe(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    received = []
    reader = threading.Thread(target=lambda: received.append(path.read_bytes()))
    reader.start()
    write_atomically(path, b"data")
    reader.join(timeout=10)
    assert received == [b"data"]
    assert stat.S_ISFIFO(path.stat().st_mode)
