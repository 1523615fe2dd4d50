"""Define the errors of the library; the message of a `DSBRDFError` is written for the user."""

WRONG_PATH_ERRORS = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)
"""Errors of the operating system that a wrong path of the user causes."""


def one_of(names: tuple[str, ...] | list[str]) -> str:
    """Join names as in ``a, b or c``."""
    return f"{', '.join(names[:-1])} or {names[-1]}" if len(names) > 1 else names[0]


class DSBRDFError(Exception):
    """Base class of all errors with a message for the user."""


class MeasurementFormatError(DSBRDFError, ValueError):
    """Raised if bytes or an array are not an acceptable measurement; the message gives the reason in one sentence."""


class InvalidArgumentError(DSBRDFError, ValueError):
    """Raised if an option, angle, direction or label is not acceptable; the message names acceptable values."""


class ModelFormatError(DSBRDFError, ValueError):
    """Raised if a stored model is damaged, or has a format or a version that this release cannot read."""


class ImageFormatError(DSBRDFError, ValueError):
    """Raised if an environment map is damaged, has an unknown format, or does not cover all directions."""


class FitError(DSBRDFError):
    """Raised if the options leave no samples of an acceptable measurement to fit."""


class ConvergenceWarning(UserWarning):
    """Issued if a fit stops at its iteration limit; the result is usable, and its report shows which parts stopped."""
