"""Dense linear algebra that lets other threads of Python run meanwhile: SciPy's own functions keep the interpreter's
lock while they compute.

Called are the same routines of LAPACK, by the addresses that SciPy hands to compiled code. Matrices are those of
Fortran, column by column, and the triangles are the lower ones.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache

import numpy as np

from clothfit.base.arrays import Array


@cache
def routine(name: str) -> Callable[..., None]:
    """A routine of LAPACK, all of whose arguments are addresses."""
    from scipy.linalg import cython_lapack

    capsule = {**cython_lapack.__pyx_capi__}[name]
    name_of, address_of = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    address_of.restype, address_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    signature = name_of(capsule)
    count = signature.count(b",") + 1
    return ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * count)(address_of(capsule, signature))  # lets the lock go


def call(name: str, A: Array) -> int:
    """Call a routine that replaces the lower triangle of A (n, n); what it says of a fault."""
    size, fault = ctypes.byref(ctypes.c_int(len(A))), ctypes.c_int(0)
    if len(A):
        routine(name)(b"L", size, laid_out(A).ctypes.data, size, ctypes.byref(fault))
    return fault.value


def factorise(A: Array) -> bool:
    """Write the Cholesky factor of A (n, n), of finite numbers, into its lower triangle; False where A is not positive
    definite. Raises ValueError for other arrays than those of Fortran.
    """
    return not call("dpotrf", A)


def invert(L: Array) -> None:
    """Write the inverse of A (n, n) over the lower triangle of its Cholesky factor."""
    call("dpotri", L)


def laid_out(A: Array) -> Array:
    """A matrix as LAPACK takes it. Raises ValueError."""
    if not (A.flags.f_contiguous and A.dtype == np.float64):
        raise ValueError("a matrix of Fortran is needed")
    return A
