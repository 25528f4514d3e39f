"""Modules that load when something of them is used: SciPy and numba import some that hardly anything needs.

A tenth of the time that a small fit takes would go into NumPy's tools for Fortran and for tests, which SciPy imports
only because it passes on all that NumPy has, into the mail parser behind the list of installed packages, in which numba
looks for extensions, and into YAML, in which numba can be configured where that is installed. The standard library's
`importlib.util.LazyLoader` would load a module as soon as another one imports it.

Of a package that is put off, `from package import module` loads that module alone: LAPACK's functions take a fifth of
the time that all of `scipy.linalg` does.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from types import ModuleType
from typing import Any

SELDOM_USED = (
    "importlib.metadata", "pydoc", "numpy.f2py", "numpy.testing", "numpy.ma", "numpy.polynomial", "numpy.ctypeslib",
    "yaml", "html",
)  # fmt: skip
LINEAR_ALGEBRA = ("scipy.linalg",)  # of which a fit uses the functions of BLAS and LAPACK


class Deferred(ModuleType):
    """A module that runs when something is asked for that only its code can give."""

    def __getattr__(self, name: str) -> Any:
        if "__path__" in self.__dict__ and find_spec(f"{self.__name__}.{name}"):
            return import_module(f"{self.__name__}.{name}")
        if name.startswith("_") and not name.startswith("__"):  # SciPy asks for modules that its wheels do not have
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}", name=name, obj=self)
        self.__class__ = ModuleType  # type: ignore[assignment]  # first, as the module may ask itself
        spec = self.__spec__
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module(self)
        return getattr(self, name)


def defer(names: tuple[str, ...] = SELDOM_USED) -> None:
    """Put off loading the modules that are not loaded yet until one of their attributes is used. Imports the packages
    that they are in.
    """
    for name in names:
        spec = None if name in sys.modules else find_spec(name)
        if spec is None or spec.loader is None:
            continue
        module = sys.modules[name] = module_from_spec(spec)
        module.__class__ = Deferred
        package, _, own = name.rpartition(".")
        if package:
            setattr(sys.modules[package], own, module)
