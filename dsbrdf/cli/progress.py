"""A progress bar on stderr, if that is a terminal and tqdm is installed."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any


@dataclass(frozen=True)
class Progress:
    """Progress and messages of a long command; made by `progress_bar`."""

    bar: Any = None

    def __call__(self, done: float) -> None:
        """Move the bar to ``done``, in the units of its total."""
        if self.bar is not None:
            self.bar.n = round(done, 2)
            self.bar.refresh()

    def write(self, line: str, *, error: bool = False) -> None:
        """Print a line to stdout, or to stderr, above the bar."""
        file = sys.stderr if error else sys.stdout
        if self.bar is None:
            print(line, file=file, flush=True)
        else:
            self.bar.write(line, file=file)


@contextmanager
def progress_bar(total: int, unit: str) -> Iterator[Progress]:
    """Show a bar during the block, if stderr is a terminal and tqdm (extra ``progress``) is installed."""
    if not sys.stderr.isatty() or find_spec("tqdm") is None:
        yield Progress()
        return
    from tqdm import tqdm  # type: ignore[import-untyped]  # ships no types

    layout = "{percentage:3.0f}% |{bar}| {n:.4g}/{total_fmt} {unit} [{elapsed}<{remaining}]"
    with tqdm(total=total, unit=unit, file=sys.stderr, leave=False, bar_format=layout) as bar:
        yield Progress(bar)
