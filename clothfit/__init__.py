"""clothfit: find the masses and stiffnesses of a mass-spring cloth whose motion matches a target.

The names in `__init__.pyi`, beside this file, are loaded when they are first used, so that `clothfit --help` does not
wait for the numerical libraries.
"""

from importlib import import_module

from clothfit.base.version import __version__ as __version__

with open(f"{__file__}i", encoding="utf-8") as _stub:
    _HOME = {name: module for _, module, _, _, _, name in (line.split() for line in _stub if " as " in line)}
"""The modules of the public names."""

_MODULES = {  # for users as well, by their own names: clothfit.verify.check(…)
    "mesh": "meshes.mesh", "mesh_problems": "meshes.problems", "verify": "derivative.verify", "weld": "meshes.problems",
}  # fmt: skip

__all__ = sorted({*_HOME, *_MODULES} - globals().keys())


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return import_module(f"clothfit.{_MODULES[name]}")
    if name not in _HOME:
        raise AttributeError(f"module 'clothfit' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
