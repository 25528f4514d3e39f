"""Temporary: use fit_vector (renamed because `clothfit.parameters` is a public function)."""

from clothfit.fit_vector import *  # noqa
