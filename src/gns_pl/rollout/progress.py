"""A progress bar with steps per second and an estimate of the time left, on a terminal only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def counting(what: str, dt: float) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on stderr while steps are counted; it leaves one line behind on a terminal and none elsewhere.

    Args:
        what: label of the bar.
        dt: simulated time of a step [s].

    Yields:
        A function to call with the number of steps made and their total.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[simulated]:.2f} s simulated, {task.fields[pace]:.3g} steps/s,"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=None, simulated=0.0, pace=0.0)

        def show(done: int, total: int) -> None:
            pace = progress.tasks[task].speed or 0.0
            progress.update(task, completed=done, total=total, simulated=done * dt, pace=pace)

        yield show
