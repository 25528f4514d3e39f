"""Four numbers at once: each function is what its name says, to the last bit."""

import threading
from fractions import Fraction

import numba
import numpy as np
import pytest

from clothfit.kernels.lanes import compiled as lanes

GUARD = 7.0
ARITHMETIC = {"add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide}
REORDERED = {
    "spread0": [0, 0, 0, 0],
    "spread1": [1, 1, 1, 1],
    "spread2": [2, 2, 2, 2],
    "turn": [1, 2, 0, 3],
    "xyzz": [0, 1, 2, 2],
    "xxxy": [0, 0, 0, 1],
    "zyyz": [2, 1, 1, 2],
    "zxyy": [2, 0, 1, 1],
}
OTHERS = ("u", "v", "w", "splat", "pack", "clear3", "load3", "fma", "lanes", "root", "where_less", "sum4")
ROWS = (*OTHERS, *ARITHMETIC, *REORDERED)


@numba.njit
def every(a, out):
    """Write what each operation makes of the rows of a (3, 8) into a row of out, as named in ROWS."""
    u, v, w = lanes.load(a, 0, 0), lanes.load(a, 1, 3), lanes.load(a, 2, 4)
    parts = lanes.pack(lanes.lane0(u), lanes.lane1(u), lanes.lane2(u), lanes.sum3(u))
    made = (
        u, v, w, lanes.splat(a[1, 1]), lanes.pack(a[0, 3], a[1, 2], a[2, 1], a[0, 0]), lanes.clear3(u),
        lanes.load3(a, 2), lanes.fma(u, v, w), parts, lanes.root(lanes.mul(u, u)), lanes.where_less(u, v, v, w),
        lanes.splat(lanes.sum4(u)), lanes.add(u, v), lanes.sub(u, v), lanes.mul(u, v), lanes.div(u, v),
        lanes.spread0(u), lanes.spread1(u), lanes.spread2(u), lanes.turn(u), lanes.xyzz(u), lanes.xxxy(u),
        lanes.zyyz(u), lanes.zxyy(u),
    )  # fmt: skip
    for row, each in enumerate(made):
        lanes.store(each, out, row, 0)


def results(a):
    """Row of four numbers by name, for the rows a (3, 8)."""
    out = np.full((len(ROWS), 4), GUARD)
    every(a, out)
    return dict(zip(ROWS, out, strict=True))


def numbers(seed):
    """Rows (3, 8) of very different sizes, so that sums in another order differ."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(3, 8)) * 10.0 ** rng.integers(-4, 5, size=(3, 8))


def test_rows_are_loaded_from_any_column_and_stored():
    a = numbers(0)
    row = results(a)
    assert row["u"].tolist() == a[0, :4].tolist()
    assert row["v"].tolist() == a[1, 3:7].tolist()
    assert row["w"].tolist() == a[2, 4:].tolist()  # the last four numbers of all
    assert row["load3"].tolist() == [*a[2, :3], 0.0]
    assert row["splat"].tolist() == [a[1, 1]] * 4
    assert row["pack"].tolist() == [a[0, 3], a[1, 2], a[2, 1], a[0, 0]]
    assert row["clear3"].tolist() == [*a[0, :3], 0.0]


@pytest.mark.parametrize("seed", range(5))
def test_each_operation_is_what_its_name_says(seed):
    a = numbers(seed)
    row, (u, v, w) = results(a), (a[0, :4], a[1, 3:7], a[2, 4:])
    for name, order in REORDERED.items():
        assert row[name].tolist() == u[order].tolist(), name
    for name, operation in ARITHMETIC.items():
        assert row[name].tolist() == operation(u, v).tolist(), name
    assert row["lanes"].tolist() == [*u[:3], (u[0] + u[1]) + u[2]]
    assert row["root"].tolist() == np.sqrt(u * u).tolist()
    assert row["where_less"].tolist() == [q if p < q else r for p, q, r in zip(u, v, w, strict=True)]
    assert row["sum4"][0] == ((u[0] + u[1]) + u[2]) + u[3]


def test_nothing_is_less_than_what_is_no_number():
    a = numbers(0)
    a[0, 1], a[1, 4] = np.nan, np.nan
    row = results(a)
    assert row["where_less"][1] == a[2, 5]


@pytest.mark.parametrize("seed", range(20))
def test_a_product_and_sum_is_rounded_once(seed):
    a = numbers(seed)
    exact = [Fraction(x) * Fraction(y) + Fraction(z) for x, y, z in zip(a[0, :4], a[1, 3:7], a[2, 4:], strict=True)]
    assert results(a)["fma"].tolist() == [float(number) for number in exact]  # which rounds to nearest


def test_three_numbers_are_read_and_written_without_touching_what_follows():
    def copy(a, i, j, out):
        lanes.store3(lanes.load3(a, i), out, j)

    a, out = np.arange(9.0).reshape(3, 3), np.full((3, 3), GUARD)
    numba.njit(copy)(a, 2, 1, out)  # the last row: behind it there is nothing to read
    assert out.tolist() == [[GUARD] * 3, [6.0, 7.0, 8.0], [GUARD] * 3]


def test_four_numbers_may_reach_into_the_next_row_and_are_written_without_touching_others():
    def copy(a, i, j, out):
        lanes.store(lanes.load(a, i, j), out, i, 2)

    a, out = np.arange(24.0).reshape(3, 8), np.full((3, 8), GUARD)
    numba.njit(copy)(a, 1, 5, out)
    expected = np.full((3, 8), GUARD)
    expected[1, 2:6] = [13.0, 14.0, 15.0, 16.0]
    assert out.tolist() == expected.tolist()


def test_arrays_of_single_precision_are_rounded_where_they_are_written_and_nowhere_else():
    def triple(a, i, j, out, exact):
        v = lanes.load(a, i, j)
        v = lanes.add(v, lanes.add(v, v))
        lanes.store(v, out, i, 2)
        lanes.store(v, exact, i, 2)

    a = np.random.default_rng(5).normal(size=(3, 8)).astype(np.float32)
    out, exact = np.full((3, 8), GUARD, np.float32), np.full((3, 8), GUARD)
    numba.njit(triple)(a, 1, 5, out, exact)
    read = a.reshape(-1)[13:17].astype(float)
    expected = np.full((3, 8), GUARD)
    expected[1, 2:6] = read + (read + read)
    assert exact.tolist() == expected.tolist()
    assert out.tolist() == expected.astype(np.float32).tolist()


def test_shared_numbers():
    def use(a, said):
        lanes.write_shared(a, 1, 5)
        said[0] = lanes.read_shared(a, 1)
        said[1] = lanes.exchange(a, 1, 4, 9)  # it is 5: nothing happens
        said[2] = lanes.read_shared(a, 1)
        said[3] = lanes.exchange(a, 1, 5, 9)
        lanes.pause(False)
        lanes.pause(True)

    a, said = np.full(3, 7, np.int64), np.zeros(4, np.int64)
    numba.njit(use)(a, said)
    assert said.tolist() == [5, 0, 5, 1]
    assert a.tolist() == [7, 9, 7]


def test_no_exchange_of_two_threads_is_lost():
    @numba.njit(nogil=True)
    def count(a, times):
        for _ in range(times):
            seen = lanes.read_shared(a, 0)
            while not lanes.exchange(a, 0, seen, seen + 1):
                seen = lanes.read_shared(a, 0)

    a = np.zeros(1, np.int64)
    count(a, 1)  # compiled before the threads start
    threads = [threading.Thread(target=count, args=(a, 50_000)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert a[0] == 100_001
