"""What a user sees of a generation: what is coming, a bar with the time left, and how it ended."""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

LINE_INTERVAL = 60.0
"""Where there is no terminal, a line is printed this often [s]."""


def readable_time(seconds: float) -> str:
    """Return a time in words: "40 s", "4 min 10 s", "2 h 5 min"."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


class GenerationProgress:
    """A bar over trajectories whose time left counts the work in each, not their number.

    Args:
        name: of the data set.
        work: file name → work in it, for the files still to be simulated; any unit.
        num_workers: as many results must be in before the time left is told.
        enabled: show anything at all.
        noun: what the work makes.
    """

    def __init__(
        self, name: str, work: Mapping[str, float], num_workers: int, *, enabled: bool, noun: str = "trajectories"
    ) -> None:
        self._name, self._work, self._num_workers, self._noun = name, work, num_workers, noun
        self._enabled = enabled
        self._console = Console(stderr=True, highlight=False, soft_wrap=True)
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.0f} of {task.total:.0f} " + noun),
            TimeElapsedColumn(),
            _TimeLeft(self),
        )
        shown = enabled and self._console.is_terminal and bool(work)
        self._bar = Progress(*columns, console=self._console, disable=not shown)
        self._task = self._bar.add_task(name, total=len(work))
        self._start = self._last_line = time.monotonic()
        self._done: list[str] = []
        self._estimate: tuple[float, float] | None = None

    def __enter__(self) -> GenerationProgress:
        self._start = self._last_line = time.monotonic()
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def log(self, message: str) -> None:
        """Print a line."""
        if self._enabled:
            self._console.print(message, markup=False)

    def finish(self, file_name: str) -> None:
        """Count a simulated file, failed or not."""
        now = time.monotonic()
        self._done.append(file_name)
        self._bar.advance(self._task)
        left = len(self._work) - len(self._done)
        if len(self._done) < self._num_workers or not left:
            return
        done, total = sum(self._work[name] for name in self._done), sum(self._work.values())
        seconds = (total - done) * (now - self._start) / done
        first, self._estimate = self._estimate is None, (now, seconds)
        if first or (not self._console.is_terminal and now - self._last_line > LINE_INTERVAL):
            self._last_line = now
            self.log(f"{self._name}: {left} {self._noun} left, about {readable_time(seconds)}.")

    def time_left(self) -> float | None:
        """Return the time left [s], None if it is not known yet."""
        if self._estimate is None:
            return None
        since, seconds = self._estimate
        return max(0.0, seconds - (time.monotonic() - since))


class _TimeLeft(ProgressColumn):
    def __init__(self, progress: GenerationProgress) -> None:
        super().__init__()
        self._progress = progress

    def render(self, task: Task) -> Text:
        seconds = self._progress.time_left()
        return Text(
            "" if seconds is None or task.finished else f"{readable_time(seconds)} left", style="progress.remaining"
        )
