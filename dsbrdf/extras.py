"""Optional dependencies: imported where they are used, and asked for by the name of their extra."""

from importlib.util import find_spec


class MissingExtraError(ImportError):
    """An optional dependency is not installed; the message is one sentence that says how to install it."""


def require(extra: str, *modules: str, purpose: str) -> None:
    """Make sure that the modules of an extra can be imported.

    Parameters
    ----------
    extra : str
        Name of the extra in ``pyproject.toml``.
    *modules : str
        Top-level modules that it provides.
    purpose : str
        What needs them, as the subject of the sentence.

    Raises
    ------
    MissingExtraError
        Naming what is missing and the command that installs it.
    """
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        names = " and ".join(missing)
        raise MissingExtraError(f"{purpose} cannot do without {names}, not installed: pip install 'dsbrdf[{extra}]'")
