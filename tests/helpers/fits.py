"""Fits whose options are given by name, and observers that call functions."""

import clothfit

ARGUMENTS = ("scene", "target", "start", "method", "model", "time_limit", "observer")


class Watching(clothfit.Observer):
    """Calls these functions."""

    def __init__(self, **called):
        vars(self).update(called)


def estimate(*given, **named):
    """`clothfit.estimate`, with the fields of `FitOptions` as arguments too."""
    own = {name: named.pop(name) for name in ARGUMENTS if name in named}
    return clothfit.estimate(*given, **own, options=clothfit.FitOptions(**named))


def estimate_many(*given, **named):
    """`clothfit.estimate_many`, likewise."""
    names = (*ARGUMENTS, "targets", "starts", "seed", "jobs", "cluster", "done")
    own = {name: named.pop(name) for name in names if name in named}
    return clothfit.estimate_many(*given, **own, options=clothfit.FitOptions(**named))
