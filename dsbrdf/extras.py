"""Optional dependencies: a clear error when an extra that a function needs is not installed."""

from importlib.util import find_spec


class MissingExtraError(ImportError):
    """An optional dependency is not installed; the message says in one sentence how to install it."""


def require(extra: str, *modules: str, purpose: str) -> None:
    """Raise a `MissingExtraError` unless the modules of an extra of ``pyproject.toml`` are installed.

    It names the missing modules, what needs them (`purpose`), and the command that installs them.
    """
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        names = " and ".join(missing)
        raise MissingExtraError(f"{names} must be installed for {purpose}: pip install 'dsbrdf[{extra}]'")
