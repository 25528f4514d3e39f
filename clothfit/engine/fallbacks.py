"""Fallbacks: where ordinary steps or solves were not enough, counted, so that the user hears of every one."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from clothfit.engine.rollout import Rollout


class Fallbacks(NamedTuple):
    """How many linear systems or steps needed which fallback."""

    direct_solves: int = 0  # factorisations where conjugate gradients did not reach the tolerance
    clamped_steps: int = 0  # steps with a positive definite matrix in place of their own (`system.clamped`)
    shortened_steps: int = 0  # steps shortened because they would have added energy (`step.guard`)
    early_contacts: int = 0  # steps taken with the contacts they begin, which would have added energy (`step.guard`)
    euler_steps: int = 0  # those of BDF2 motions after the first, of first order (`march.hits`, `step.guard`)
    longer_steps: int = 0  # steps of more iterations, as contacts or the energy were not right (`rollout.more`)

    def with_those_of(self, part: Rollout, second: bool) -> Fallbacks:
        """These and those of a part of a motion, of `second` order or not."""
        return Fallbacks(
            self.direct_solves + int(part.solves[:, 1].sum()),
            self.clamped_steps + int(part.clamped.sum()),
            self.shortened_steps + int((part.theta < 1.0).sum()),
            self.early_contacts + int(part.predicted.sum()),
            self.euler_steps + second * int(part.euler[int(part.first == 0) :].sum()),
            self.longer_steps + int((part.more > 0).sum()),
        )

    def together(self, other: Fallbacks) -> Fallbacks:
        """These and others."""
        return Fallbacks(*(a + b for a, b in zip(self, other, strict=True)))

    def sentences(self, steps: int) -> list[str]:
        """What a user should know, for motions of this many steps in all."""
        finer = "shorter steps (delta; --substeps of a fit) need less of it"
        said = (
            "{} times a step was hard to compute; that takes time alone",
            f"{{}} of {steps} steps were stabilised (strong compression): folds are smoother there; {finer}",
            f"{{}} of {steps} steps were stabilised (too fast for the step): the cloth is slowed down there; {finer}",
            f"{{}} of {steps} steps were stabilised (deep in a sphere at once): it comes off otherwise there; {finer}",
            f"{{}} of {steps} steps are of first order, as BDF2 hits something there, or would gain energy",
            f"{{}} of {steps} steps were computed again from where they ended; that takes time alone",
        )
        return [sentence.format(count) for count, sentence in zip(self, said, strict=True) if count]


NO_FALLBACKS = Fallbacks()
"""Those of ordinary steps."""
