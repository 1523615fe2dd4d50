"""The flags of ``dsbrdf serve``: some of the settings."""

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Annotated, Any

from cyclopts import Parameter

from dsbrdf.cli.commands import new_application, run_words

from ..settings import Settings

_PURPOSE = "Run the HTTP service. Further settings are environment variables that begin with DSBRDF_."


def _flag(name: str) -> Parameter:
    setting = Settings.model_fields[name]
    default = "one for each core" if name == "workers" else setting.default
    return Parameter(help=f"{setting.description}{f' Default: {default}.' if default else ''}", metavar=name.upper())


def flags(
    *,
    host: Annotated[str | None, _flag("host")] = None,
    port: Annotated[str | None, _flag("port")] = None,
    data_dir: Annotated[str | None, _flag("data_dir")] = None,
    workers: Annotated[str | None, _flag("workers")] = None,
    insecure: Annotated[bool | None, _flag("insecure")] = None,
) -> dict[str, Any]:
    """Return the flags that are given, as text, which `Settings` checks."""
    return {name: value for name, value in locals().items() if value is not None}


def run_with_flags(words: Sequence[str], serve: Callable[[Mapping[str, Any]], int]) -> int:
    """Call `serve` with the flags that `words` give; return the exit code."""

    @wraps(flags)
    def run(**given: Any) -> int:
        return serve(flags(**given))

    app = new_application("dsbrdf serve", _PURPOSE)
    app.default(run)
    return run_words(app, words)
