"""Modules that load when something of them is used: SciPy and numba import some that hardly anything needs.

A tenth of the time that a small fit takes would go into NumPy's tools for Fortran and for tests, which SciPy imports
only because it passes on all that NumPy has, and into the mail parser behind the list of installed packages, in which
numba looks for extensions. `importlib.util.LazyLoader` is the standard library's way to put that off.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib.util import LazyLoader, module_from_spec

SELDOM_USED = (
    "importlib.metadata", "pydoc", "numpy.f2py", "numpy.testing", "numpy.ma", "numpy.polynomial", "numpy.ctypeslib",
)  # fmt: skip


def defer(names: tuple[str, ...] = SELDOM_USED) -> None:
    """Put off loading the modules that are not loaded yet until one of their attributes is used. Imports the packages
    that they are in.
    """
    for name in names:
        spec = None if name in sys.modules else importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            continue
        spec.loader = LazyLoader(spec.loader)
        module = sys.modules[name] = module_from_spec(spec)
        spec.loader.exec_module(module)
        package, _, own = name.rpartition(".")
        if package:
            setattr(sys.modules[package], own, module)
