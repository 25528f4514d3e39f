import io
import os

import pytest
from helpers.files import Stream

from clothfit.base import memory
from clothfit.base.reading import whole


def trickle(data):
    """A stream that gives a byte at a time."""
    return Stream(data, 1, endless=False)


@pytest.mark.parametrize("data", [b"", b"abc", bytes(100)])
def test_all_is_read_whatever_the_stream(tmp_path, data):
    path = tmp_path / "file"
    path.write_bytes(data)
    with open(path, "rb") as file:
        assert whole(file, 100) == data
    assert whole(io.BytesIO(data), 100) == whole(trickle(data), 100) == data
    assert whole(io.StringIO("é" * 100), 100) == "é" * 100


def test_a_file_that_is_too_large_is_not_begun(tmp_path):
    with open(tmp_path / "sparse", "wb+") as file:
        os.truncate(file.fileno(), 10**12)
        with pytest.raises(OSError, match="it has more than the 500 MB that can be read"):
            whole(file, 500_000_000)
        assert file.tell() == 0


def test_a_file_that_grows_as_fast_as_it_is_read_is_left(tmp_path):
    path = tmp_path / "log"
    path.write_bytes(b"abc")

    class Growing(io.FileIO):
        def read(self, size=-1):
            with open(path, "ab") as file:
                file.write(b"d")
            return super().read(size)

    with Growing(path) as file, pytest.raises(OSError, match="it changed while it was read; try again"):
        whole(file, 500_000_000)


def test_a_stream_without_end_is_left_at_the_limit():
    stream = Stream(b"")
    with pytest.raises(OSError, match="more than the 1 kB that can be read"):
        whole(stream, 1000)
    assert stream.given == 1001


def test_without_a_limit_it_is_half_of_the_free_memory(monkeypatch):
    monkeypatch.setattr(memory, "free", lambda: 198)
    assert whole(io.BytesIO(bytes(99))) == bytes(99)
    with pytest.raises(OSError, match="more than the 99 bytes for which there is memory"):
        whole(io.BytesIO(bytes(100)))


def test_what_gives_neither_text_nor_bytes_is_no_file():
    stream = trickle([1, 2])
    with pytest.raises(TypeError, match="the file gave list instead of text or bytes"):
        whole(stream, 10)
