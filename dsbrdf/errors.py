"""What can go wrong, as a tree.

DSBRDFError
├── MeasurementFormatError   a file or array is not an acceptable measurement
├── InvalidArgumentError     an option, angle, direction or label is not acceptable
├── ModelFormatError         a stored model cannot be read
└── FitError                 an acceptable measurement cannot be fitted with these options

ConvergenceWarning           a fit stopped before it converged; its report says where
"""


class DSBRDFError(Exception):
    """Base of every error that this library raises on purpose."""


class MeasurementFormatError(DSBRDFError, ValueError):
    """The bytes or the array are not an acceptable measurement; the message is one sentence that says why."""


class InvalidArgumentError(DSBRDFError, ValueError):
    """An option, angle, direction or label is out of its range; the message says what would be right."""


class ModelFormatError(DSBRDFError, ValueError):
    """A stored model is damaged, of another format, or of a version that this release does not know."""


class FitError(DSBRDFError):
    """The measurement is well formed but leaves nothing to fit with the options given."""


class ConvergenceWarning(UserWarning):
    """A fit stopped at its iteration bound; the result is usable and its report says where."""
