"""A progress bar with the time left on stderr, if that is a terminal and rich is installed."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID


@dataclass(frozen=True)
class Progress:
    """Progress and messages of a long command; made by `progress_bar`."""

    bar: "Bar | None" = None
    task: "TaskID | None" = None

    def __call__(self, done: float) -> None:
        """Move the bar to ``done``, in the units of its total."""
        if self.bar is not None and self.task is not None:
            self.bar.update(self.task, completed=done, done=f"{done:.4g}")

    def write(self, line: str, *, error: bool = False) -> None:
        """Print a line to stdout, or to stderr, above the bar."""
        if self.bar is not None:
            self.bar.stop()  # which takes the bar away, so that the line can go to another stream
        print(line, file=sys.stderr if error else sys.stdout, flush=True)
        if self.bar is not None:
            self.bar.start()


@contextmanager
def progress_bar(total: int, unit: str) -> Iterator[Progress]:
    """Show a bar during the block, if stderr is a terminal and rich (extra ``cli``) is installed."""
    if not sys.stderr.isatty() or find_spec("rich") is None:
        yield Progress()
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        BarColumn(),
        TextColumn("{task.fields[done]}/{task.total} {task.description}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    console = Console(file=sys.stderr)
    with Bar(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as bar:
        yield Progress(bar, bar.add_task(unit, total=total, done="0"))
