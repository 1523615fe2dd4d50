"""Optional dependencies: a clear error when an extra that a function needs is not installed."""

from importlib.util import find_spec


class MissingExtraError(ImportError):
    """An optional dependency is not installed; the message says in one sentence how to install it."""


def require(extra: str, *modules: str, purpose: str) -> None:
    """Raise an error unless the modules of an extra are installed.

    Parameters
    ----------
    extra : str
        Name of the extra in ``pyproject.toml``.
    *modules : str
        The modules to look for.
    purpose : str
        What needs them, for the error message.

    Raises
    ------
    MissingExtraError
        With the missing modules and the command that installs them.
    """
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        names = " and ".join(missing)
        raise MissingExtraError(f"{names} must be installed for {purpose}: pip install 'dsbrdf[{extra}]'")
