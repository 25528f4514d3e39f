"""How a fit is doing, shown while it runs: a panel on a terminal, elsewhere a plain line every few seconds.

Both tell the same: cost and RMSE of the best point, the stage and how many of the frames it compares, the last step
(the largest relative change of a parameter), evaluations per second, and roughly the time left, where the trend of the
cost says it (`optimise.progress.Trend`).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from clothfit.base.messages import metres
from clothfit.cli.common.console import Console

if TYPE_CHECKING:
    from rich.console import RenderableType

    from clothfit.optimise.progress import Progress

ROUGH = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, *(60.0 * minutes for minutes in (1, 2, 5, 10, 20, 30, 60)))
"""Seconds that are left, as they are shown."""

RECENT = 10.0
"""Seconds over which the pace is taken."""

PLAIN_INTERVAL = 5.0
"""Seconds between plain lines."""

BARS = "▁▂▃▄▅▆▇█"
PANEL_WIDTH, CURVE_WIDTH = 76, 40  # characters of the panel, and of the curve of the RMSE


class Pace:
    """Evaluations per second, of late."""

    def __init__(self) -> None:
        self.marks: deque[tuple[float, int]] = deque()  # seconds and evaluations

    def update(self, progress: Progress) -> float:
        """The pace at some progress, 1/s; 0 where it is not known yet."""
        self.marks.append((progress.seconds, progress.evaluations))
        while len(self.marks) > 2 and self.marks[1][0] < progress.seconds - RECENT:
            self.marks.popleft()
        (since, before), (now, count) = self.marks[0], self.marks[-1]
        if now > since:
            return (count - before) / (now - since)
        return count / now if now > 0 else 0.0


def error(value: float, unit: str) -> str:
    """An error in the unit of what is compared."""
    return metres(value) + unit[1:] if unit else f"{value:.3g}"


def state(progress: Progress) -> str:
    """Cost, error and evaluations."""
    return f"cost {progress.cost:.3e}  RMSE {error(progress.rmse, progress.unit)}  evaluation {progress.evaluations}"


def stage(progress: Progress) -> list[str]:
    """What is being done, on how many frames, and the last step; as far as known."""
    known = [progress.stage] if progress.stage else []
    if progress.frames:
        known.append(f"{progress.window} of {progress.frames} frames")
    if math.isfinite(progress.window_rmse):
        known.append(f"RMSE there {error(progress.window_rmse, progress.unit)}")
    if math.isfinite(progress.step):
        known.append(f"step {100 * progress.step:.2g} %")
    return known


def pace(progress: Progress, rate: float, trend: float | None) -> list[str]:
    """Evaluations per second, and the time left by the `trend` of the cost, s, or until the limit of evaluations."""
    if not rate > 0:
        return []
    speed = f"{rate:.3g} evaluations/s"
    if trend is None:
        return [speed]
    left = min(trend, max(progress.budget - progress.evaluations, 0) / rate)
    return [speed, f"roughly {duration(rough(left))} left"]


def rough(seconds: float) -> float:
    """The next of 1, 2, 5, 10, 20, 30 s, 1, 2, 5, 10, … min: a trend says no more."""
    return next((each for each in ROUGH if each >= seconds), seconds)


def duration(seconds: float) -> str:
    """A time in the units that suit it."""
    if seconds < 60:
        return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


@contextmanager
def progress(console: Console) -> Iterator[Callable[[Progress], None] | None]:
    """Show the progress of a fit while the block runs; gives what to call with it, None where the console is quiet."""
    if console.quiet:
        yield None
    elif console.animated:
        with live() as show:
            yield show
    else:
        yield plain(console.say)


def now_and_then(say: Callable[[str], None], seconds: float = PLAIN_INTERVAL) -> Callable[[Callable[[], str]], None]:
    """What says a line, which is made then, not more often than every so many seconds."""
    last = [time.perf_counter()]

    def tell(line: Callable[[], str]) -> None:
        now = time.perf_counter()
        if now - last[0] >= seconds:
            last[0] = now
            say(line())

    return tell


def plain(say: Callable[[str], None]) -> Callable[[Progress], None]:
    """What tells a line every few seconds."""
    tell, shown = now_and_then(say), PanelState()

    def show(progress: Progress) -> None:
        shown.update(progress)
        tell(lambda: "  ".join([f"{progress.seconds:6.1f} s", state(progress), *stage(progress),
                                *pace(progress, shown.rate, shown.left)]))  # fmt: skip

    return show


@contextmanager
def live() -> Iterator[Callable[[Progress], None]]:
    """Show a panel on standard error while the block runs; nothing of it stays."""
    from rich.console import Console as Terminal
    from rich.live import Live

    console = Terminal(stderr=True)
    shown = PanelState(min(console.width, PANEL_WIDTH))
    with Live(console=console, transient=True, refresh_per_second=8, get_renderable=shown.panel):
        yield shown.update


class PanelState:
    """What the panel holds."""

    def __init__(self, width: int = PANEL_WIDTH) -> None:
        from clothfit.optimise.progress import Trend

        self.width, self.began = width, time.perf_counter()
        self.progress: Progress | None = None
        self.known, self.rate = Pace(), 0.0
        self.trend = Trend()
        self.left: float | None = None
        self.errors: list[float] = []

    def update(self, progress: Progress) -> None:
        """Take a progress note of."""
        self.progress, self.rate, self.left = progress, self.known.update(progress), self.trend.update(progress)
        self.errors.append(progress.rmse)

    def panel(self) -> RenderableType:
        """The panel, as it is now."""
        from rich.panel import Panel
        from rich.text import Text

        lines = Text("\n".join(self.lines()))
        lines.highlight_regex(f"[{BARS}]+", "cyan")
        lines.highlight_regex("^cost .*", "bold")
        title = f"fitting  {duration(time.perf_counter() - self.began)}"
        return Panel(lines, title=title, title_align="left", border_style="dim", width=self.width, padding=(0, 1))

    def lines(self) -> list[str]:
        """Its lines."""
        if self.progress is None:
            return ["looking at target and start …"]
        found = [f"{state(self.progress)} of at most {self.progress.budget}"]
        parts = (stage(self.progress), pace(self.progress, self.rate, self.left))
        found += [", ".join(items) for items in parts if items]
        curve = sparkline(self.errors)
        first, last = (error(value, self.progress.unit) for value in (self.errors[0], self.errors[-1]))
        return [*found, f"{curve} {first} → {last}"] if len(curve) > 1 else found


def sparkline(values: Sequence[float], width: int = CURVE_WIDTH) -> str:
    """A small curve of values above 0, in their logarithm, of as many characters at most."""
    logs = [math.log(max(value, 1e-15)) for value in values if value < math.inf]
    if len(logs) > width:
        logs = [logs[round(i * (len(logs) - 1) / (width - 1))] for i in range(width)]
    low, high = min(logs, default=0.0), max(logs, default=0.0)
    size = (high - low) or 1.0
    return "".join(BARS[min(int((value - low) / size * len(BARS)), len(BARS) - 1)] for value in logs)
