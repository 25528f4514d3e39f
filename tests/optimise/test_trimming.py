"""Which steps can be in balance: linear systems of which some steps are wrong."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from clothfit.optimise.momentum import trimmed

pytestmark = pytest.mark.quick


class Dense:
    """Equations C q = r of S steps with N rows each."""

    def __init__(self, C, r):
        self.C, self.r, self.counts = C, r, np.full(len(C), C.shape[1])
        self.Q = C.shape[2]

    def sizes(self, q):
        away, terms = self.r - self.C @ q, np.abs(self.C) @ np.abs(q)
        return np.linalg.norm(away, axis=1), np.linalg.norm(terms, axis=1)

    def gram(self, kept):
        C = self.C[kept].reshape(-1, self.C.shape[2])
        return csr_array(C.T @ C)

    def right(self, q, kept):
        away = self.r[kept] - self.C[kept] @ q
        return self.C[kept].reshape(-1, self.C.shape[2]).T @ away.ravel()


def kept_of(C, r):
    rows, every = Dense(C, r), np.ones(len(C), bool)
    return trimmed(rows, every, rows.gram(every).toarray())


@pytest.mark.parametrize(("out", "noise", "kept"), [(4, 0.03, 36), (15, 0.03, 40), (15, 1e-5, 25), (18, 0.0, 22)])
def test_what_is_left_out_is_little_unless_the_rest_is_exact(out, noise, kept):
    # of 15 exceptions among 40 nobody can say that they are exceptions, but where the others leave nothing
    rng = np.random.default_rng(4)
    C, q = rng.normal(size=(40, 30, 5)), rng.normal(size=5)
    r = C @ q + noise * rng.normal(size=(40, 30))
    r[:out] += rng.normal(size=(out, 30))
    assert kept_of(C, r).sum() == kept


@pytest.mark.parametrize("first", [0, 10, 22])
def test_steps_that_agree_with_one_another_are_not_taken_for_the_rest(first):
    # 18 steps in a row follow another law, with larger rows: the balance of all steps is nearer to theirs
    rng = np.random.default_rng(7)
    C, q = rng.normal(size=(40, 30, 5)), rng.normal(size=5)
    C[first : first + 18] *= 30.0
    r = C @ q
    r[first : first + 18] = C[first : first + 18] @ (q + 1.0) + rng.normal(size=(18, 30))
    wrong = np.zeros(40, bool)
    wrong[first : first + 18] = True
    np.testing.assert_array_equal(kept_of(C, r), ~wrong)


@pytest.mark.parametrize(("rounding", "kept"), [(1e-10, 40), (1e-6, 36)])
def test_residuals_that_are_nothing_beside_what_they_are_left_of_put_no_step_out(rounding, kept):
    rng = np.random.default_rng(5)
    C, q = rng.normal(size=(40, 30, 5)), rng.normal(size=5)
    size = np.repeat([1e4, 1.0], [4, 36])[:, None]  # the first steps were solved less accurately
    r = C @ q + rounding * size * rng.normal(size=(40, 30))
    assert kept_of(C, r).sum() == kept
