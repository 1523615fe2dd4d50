"""Check optional dependencies: raise a clear error if an extra that a function needs is not installed."""

from importlib.util import find_spec


class MissingExtraError(ImportError):
    """Raised if an optional dependency is not installed; the message contains the command that installs it."""


def require(extra: str, *modules: str, purpose: str) -> None:
    """Raise MissingExtraError unless the modules of an extra in ``pyproject.toml`` are installed.

    The message contains the missing modules, their `purpose`, and the command that installs them.
    """
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        names = " and ".join(missing)
        raise MissingExtraError(f"{names} must be installed for {purpose}: pip install 'dsbrdf[{extra}]'")
