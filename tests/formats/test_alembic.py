"""Alembic: transforms, and files that are damaged. Blender's files: test_other_programs."""

import random
from pathlib import Path

import numpy as np
import pytest

from clothfit.base.errors import InvalidMotion
from clothfit.formats import alembic

SHEET = (Path(__file__).parent / "blender" / "sheet.abc").read_bytes()
TRANSLATE, SCALE, ROTATE, MATRIX, ROTATE_X, ROTATE_Y, ROTATE_Z = 1, 0, 2, 3, 4, 5, 6


# Points are row vectors: they are multiplied by the last operation first. A quarter about z takes x to y.
def test_operations_apply_from_the_last_to_the_first():
    values = np.array([1.0, 2, 3, 90, 2, 3, 4])
    matrix = alembic._product(np.array([TRANSLATE, ROTATE_Z, SCALE]), values)
    np.testing.assert_allclose([1, 1, 1, 1] @ matrix, [1 - 3, 2 + 2, 3 + 4, 1], atol=1e-15)


@pytest.mark.parametrize(("code", "axis"), [(ROTATE_X, 0), (ROTATE_Y, 1), (ROTATE_Z, 2)])
def test_turns_about_an_axis_are_turns_about_the_same_given_axis(code, axis):
    one, other = alembic._product(np.array([code]), np.array([37.0])), 5.0 * np.eye(3)[axis]
    np.testing.assert_allclose(one, alembic._product(np.array([ROTATE]), np.array([*other, 37.0])), atol=1e-15)
    np.testing.assert_allclose(one, alembic._product(np.array([MATRIX]), one.reshape(-1)), atol=0)
    following = np.eye(4)[(axis + 1) % 3] @ one  # x to y, y to z, z to x, by 37 degrees
    assert following[(axis + 2) % 3] == pytest.approx(np.sin(np.radians(37)), rel=1e-14)


def damaged(chance):
    """The sheet, cut off, or with other bytes in it, or with a place that is another."""
    data = bytearray(SHEET)
    kind = chance.randrange(3)
    if kind == 0:
        return bytes(data[: chance.randrange(len(data))])
    if kind == 1:
        for _ in range(chance.randrange(1, 6)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        return bytes(data)
    at, value = (
        chance.randrange(len(data) - 8),
        chance.choice([0, 2**63, 2**64 - 1, chance.randrange(len(data)), 2**31]),
    )
    return bytes(data[:at]) + value.to_bytes(8, "little") + bytes(data[at + 8 :])


def test_a_damaged_file_is_read_or_refused_with_its_name(tmp_path):
    path, messages = tmp_path / "a.abc", []
    for seed in range(400):
        path.write_bytes(damaged(random.Random(seed)))
        try:
            found = alembic.read(path)
        except InvalidMotion as error:
            messages.append(str(error))
        else:
            assert np.isfinite(found.positions).all()
            assert found.triangles is None or found.triangles.max() < found.positions.shape[1]
    assert 100 < len(messages) < 400
    assert all(text.startswith("a.abc: ") and "\n" not in text for text in messages)
