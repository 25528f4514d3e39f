import io
import struct
import warnings
import zipfile

import numpy as np
import pytest
from helpers.files import Stream

from clothfit.base import memory, npz

NAMES = ("a", "b")
RNG = np.random.default_rng(1)


def archive(*members, method=zipfile.ZIP_STORED):
    """A zip archive of names and data."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as made, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a name that is there twice
        for name, data in members:
            made.writestr(name, data)
    return file.getvalue()


def npy(text, data=b"", wide=False):
    """A `.npy` file with a header of that text."""
    length = struct.pack("<I" if wide else "<H", len(text))
    return b"\x93NUMPY" + (b"\2\0" if wide else b"\1\0") + length + text.encode("latin-1") + data


def header(shape="(2,)", descr="<f8"):
    """The text of a header."""
    return f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n"


def read(data):
    return {name: array.read() for name, array in npz.stored(io.BytesIO(data), NAMES, "a").items()}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("kind", ["f2", "<f4", ">f8", "i1", ">i4", "u8", "?", "c16", "U3", "S2", "M8[s]"])
def test_what_numpy_writes_is_read(save, kind):
    value = (100 * RNG.random((3, 2, 4))).astype("i4").astype(kind)
    for array in (value, np.asfortranarray(value), value[:0], value[0, 0, 0], value[::2, :, 1]):
        file = io.BytesIO()
        save(file, a=array, b=np.arange(5.0), other=np.zeros(3))
        found = read(file.getvalue())
        assert sorted(found) == ["a", "b"]
        assert found["a"].dtype == array.dtype
        np.testing.assert_array_equal(found["a"], array)
        np.testing.assert_array_equal(found["b"], np.arange(5.0))


def test_a_bare_array_is_read_and_one_of_items_without_size():
    assert [array.shape for array in read(npy(header("(2,)", "|S0"))).values()] == [(2,)]
    file = io.BytesIO()
    np.save(file, np.asfortranarray(np.arange(6.0).reshape(2, 3)))
    np.testing.assert_array_equal(read(file.getvalue())["a"], np.arange(6.0).reshape(2, 3))


@pytest.mark.parametrize("wide", [False, True])
def test_headers_of_other_writers_are_read(wide):
    value, dense = np.array([1.0, 2.0]), "{'fortran_order':False,'descr':'<f8','shape':( 2L , )}"
    for text in ('{"shape": (2,), "fortran_order": False, "descr": "<f8"}', dense, header() + " " * 500):
        np.testing.assert_array_equal(read(npy(text, value.tobytes(), wide))["a"], value)


NOT_PLAIN = "its header does not give the type and shape of plain numbers"
STRANGE = "the header of the array is not one of NumPy's"

# Headers, and what is said of them.
HEADERS = {
    "objects": (header(descr="|O"), "it holds pickled objects"),
    "more numbers than there are": (header("(3,)"), "it ends early: 24 bytes of numbers are promised, 16 are there"),
    "huge": (header("(115292150460684697, 9, 3)"), "it ends early: "),
    "negative": (header("(-1,)"), NOT_PLAIN),
    "no tuple": (header("2"), NOT_PLAIN),
    "records": ("{'descr': [('x', '<f8')], 'fortran_order': False, 'shape': (2,), }", NOT_PLAIN),
    "twice": (header() + header(), NOT_PLAIN),
    "code": ("__import__('os').system('true')", NOT_PLAIN),
    "deep": ("(" * 9000, NOT_PLAIN),
    "nothing": ("", NOT_PLAIN),
    "no type": (header(descr="f99"), "there is no type 'f99' of plain numbers"),
    "a type of pointers": (header(descr="T"), "there is no type 'T' of plain numbers"),
    "several types": (header(descr="<f8, <f8"), "there is no type '<f8, <f8' of plain numbers"),
    "a wide type": (header(descr="V999999999"), "it ends early: "),
    "long": (header() + " " * 10_000, STRANGE),
}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        *((npy(text, bytes(16)), message) for text, message in HEADERS.values()),
        *((archive(("a.npy", npy(text, bytes(16)))), message) for text, message in HEADERS.values()),
        (b"\x93NUMPY\2\0" + struct.pack("<I", 2**32 - 16) + b"x", STRANGE),
        (b"\x93NUMPY\7\0\0\0", STRANGE),
        (b"\x93NUMPY", "what it holds is not an array"),
        (b"", "it is neither"),
        (archive(("a.npy", b"hello")), "what it holds is not an array"),
        (archive(("a", npy(header(), bytes(16))), ("a.npy", npy(header(), bytes(16)))), "it holds a more than once"),
        (archive(("a.npy", npy(header(), bytes(16))), method=zipfile.ZIP_LZMA), "it is packed in another way"),
    ],
)
def test_headers_that_lie_and_files_that_are_not_in_order_are_refused_before_anything_is_read(data, message):
    with pytest.raises(npz.FAULTS) as caught:
        npz.stored(io.BytesIO(data), NAMES, "a")
    assert str(caught.value).startswith(message)


def test_an_archive_of_too_many_files_is_refused():
    with pytest.raises(npz.FAULTS, match="it holds too many files to be a motion"):
        npz.stored(io.BytesIO(archive(*((f"{i:050}", b"") for i in range(12_000)))), NAMES, "a")


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_damage_is_noticed_by_the_checksum_and_what_is_encrypted_is_refused(method):
    value = RNG.random(1000)
    data = bytearray(archive(("a.npy", npy(header("(1000,)"), value.tobytes())), method=method))
    data[4000] ^= 1
    with pytest.raises(npz.FAULTS):
        read(bytes(data))
    data[6] |= 1
    data[data.rindex(b"PK\1\2") + 8] |= 1
    with pytest.raises(ValueError, match="it is encrypted"):
        npz.stored(io.BytesIO(bytes(data)), NAMES, "a")


def test_little_that_unpacks_to_much_is_refused(monkeypatch):
    monkeypatch.setattr(npz, "UNPACKED_FREELY", 100_000)
    zeros = npy(header("(100000,)"), bytes(800_000))
    with pytest.raises(ValueError, match=r"bytes unpack to 800000; write it with numpy\.savez, not compressed"):
        read(archive(("a.npy", zeros), method=zipfile.ZIP_DEFLATED))
    assert not read(archive(("a.npy", zeros)))["a"].any()
    few = npy(header("(10000,)"), bytes(80_000))  # below ROOM it may be as small as it can
    assert not read(archive(("a.npy", few), method=zipfile.ZIP_DEFLATED))["a"].any()


def test_what_nobody_reads_takes_no_memory():
    """800 MB in 800 kB: types and shapes are known from the header alone."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as made, made.open("a.npy", "w") as member:
        member.write(npy(header("(100000000,)")))
        for _ in range(8):
            member.write(bytes(100_000))
    data = bytearray(file.getvalue())
    central = data.rindex(b"PK\1\2")
    data[central + 24 : central + 28] = struct.pack("<I", 800_001_000)
    found = npz.stored(io.BytesIO(bytes(data)), NAMES, "a")["a"]
    assert (found.shape, found.nbytes) == ((100_000_000,), 800_000_000)


def test_of_what_does_not_begin_as_arrays_do_no_more_is_read_than_of_a_text(monkeypatch):
    monkeypatch.setattr(npz, "MOST_TEXT", 1000)
    monkeypatch.setattr(memory, "free", lambda: 10_000)
    device, long = Stream(b""), Stream(b"PK\3\4")
    with pytest.raises(OSError, match="more than the 1 kB that can be read"):
        npz.content(device)
    with pytest.raises(OSError, match="more than the 5 kB for which there is memory"):
        npz.content(long)
    assert (device.given, long.given) == (6 + 1001, 6 + 5001)


@pytest.mark.parametrize("data", [b"", b"PK", b"{}", b"PK" + bytes(2000), b"\x93NUMPY" + bytes(2000)])
def test_a_whole_file_is_read(data):
    assert npz.content(io.BytesIO(data)) == data
