"""The digest of what compiled code depends on: other where the code would be, the same where it would not."""

from typing import Any, NamedTuple

import numba
import pytest
from helpers.modules import module_of

from clothfit.kernels.dependencies import digest, types_text

TEXT = '''
"""A module."""
from typing import NamedTuple
import numpy as np
from clothfit.kernels.kernel import kernel
FACTOR = 2.0
TABLE = np.arange(3.0)
UNUSED = 1

class Pair(NamedTuple):
    left: float
    right: float

@kernel
def deepest(x):
    return FACTOR * np.sqrt(x)

@kernel
def inner(x):
    """Words."""
    return deepest(x) + TABLE[0]

@kernel
def entry(x, flag=True):
    pair = Pair(inner(x), 1.0)
    return pair.left if flag else pair.right

def of_python(x):
    return x
'''


def of(old="", new=""):
    """The digest of the entry after an edit."""
    assert old in TEXT
    return digest(module_of(TEXT.replace(old, new), "edited").entry.py_func)


EDITS = {  # what they change of what is compiled, through all calls, or of anything else
    True: [
        ("FACTOR * np.sqrt", "FACTOR + np.sqrt"), ("np.sqrt", "np.cbrt"),
        ("FACTOR = 2.0", "FACTOR = 2.0000000000000004"), ("np.arange(3.0)", "np.arange(1.0, 4.0)"),
        ("flag=True", "flag=False"), ("TABLE[0]", "TABLE[1]"),
        ("left: float\n    right: float", "right: float\n    left: float"),
    ],
    False: [
        ('"""Words."""', '"""Other words."""'), ("UNUSED = 1", "UNUSED = 2  # and a remark"),
        ("    return x\n", "    return 2 * x\n"), ("@kernel\ndef deepest", "\n\n@kernel\ndef deepest"),
    ],
}


@pytest.mark.parametrize(("old", "new", "seen"), [(*edit, seen) for seen, edits in EDITS.items() for edit in edits])
def test_an_edit_of_what_is_compiled_is_seen_and_one_of_anything_else_is_not(old, new, seen):
    assert (of(old, new) != of()) == seen


def test_kernels_of_another_module_are_followed_where_they_are_called_through_it():
    def through(text):
        other = module_of(text, "other")
        calling = module_of(TEXT.replace("deepest(x) +", "other.deepest(x) +"), "edited")
        calling.other = other
        other.__name__ = "clothfit.other"
        return digest(calling.entry.py_func)

    assert through(TEXT) == through(TEXT.replace("TABLE[0]", "TABLE[1]"))  # `inner` of the other one is not called
    assert through(TEXT) != through(TEXT.replace("2.0", "3.0"))


def test_the_engines_code_depends_on_its_forces_and_not_on_its_fits():
    from clothfit.engine import march
    from clothfit.engine.forces import collider_rows, contact, springs
    from clothfit.engine.forces.selfcontact import rows
    from clothfit.kernels.dependencies import reached

    functions, of_force = reached(march.run.py_func), reached(springs.add_step.py_func)
    assert springs.energy.py_func in functions
    assert springs.lengths.py_func in of_force
    assert springs.add_step.py_func not in functions  # compiled by itself
    assert not any(each.__module__.startswith(("clothfit.fit", "clothfit.optimise")) for each in functions | of_force)
    assert reached(march.run.py_func, plain=True) < functions
    assert {collider_rows.level.py_func, rows.level.py_func} < reached(contact.energy.py_func)  # of each kind


class Old(NamedTuple):
    a: Any
    b: Any


def test_types_name_the_fields_of_records():
    kind = numba.typeof(Old(1.0, (2, Old(1.0, 2.0))))
    assert types_text((kind,)).count("('a', 'b')") == 2
