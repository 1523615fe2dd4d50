"""The errors of the library: a `DSBRDFError` is raised on purpose, with a message for the user."""

WRONG_PATH_ERRORS = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)
"""Errors of the operating system that mean a wrong path, not a fault of the machine."""


def one_of(names: tuple[str, ...] | list[str]) -> str:
    """Join names for a sentence: ``a, b or c``."""
    return f"{', '.join(names[:-1])} or {names[-1]}" if len(names) > 1 else names[0]


class DSBRDFError(Exception):
    """Base class of all errors that the library raises on purpose."""


class MeasurementFormatError(DSBRDFError, ValueError):
    """The bytes or the array are not an acceptable measurement; the message says why in one sentence."""


class InvalidArgumentError(DSBRDFError, ValueError):
    """An option, angle, direction or label is not acceptable; the message says what would be."""


class ModelFormatError(DSBRDFError, ValueError):
    """A stored model is damaged, has another format, or a version that this release cannot read."""


class ImageFormatError(DSBRDFError, ValueError):
    """An environment map is damaged, in an unknown format, or does not cover all directions."""


class FitError(DSBRDFError):
    """The measurement is acceptable, but with the given options no samples are left to fit."""


class ConvergenceWarning(UserWarning):
    """A fit stopped at its iteration limit; the result is usable, and its report says which part did not converge."""
