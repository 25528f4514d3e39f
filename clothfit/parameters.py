"""Temporary: use fit_vector (renamed because `clothfit.parameters` is a public function)."""
from clothfit.fit_vector import *  # noqa
from clothfit.fit_vector import LOWER, UPPER, NAMES, Block, blocks, size, fitted_cloths, parameters, with_parameters, check_shape, elements, hidden, unidentifiable, identifiable  # noqa
