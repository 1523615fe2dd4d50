"""What a mistake on the command line is called: one sentence, in the words of the command line and not of Python."""

from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from cyclopts import (
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    RepeatArgumentError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from dsbrdf.cli.arguments import did_you_mean


def usage_sentence(error: CycloptsError) -> str:
    """Return what is wrong, and what would be right."""
    command = " ".join(["dsbrdf", *(error.command_chain or ())])
    return f"{command}: {_reason(error).removesuffix('.')} (see {command} --help)"


def _reason(error: CycloptsError) -> str:
    if isinstance(error, UnknownOptionError):
        name = error.token.keyword or error.token.value
        known = [name for argument in error.argument_collection for name in argument.names]
        return f"there is no option {name}{did_you_mean(name, known)}"
    if isinstance(error, UnusedCliTokensError):
        return f"there is no place for {' '.join(error.unused_tokens or ())}"
    if isinstance(error, RepeatArgumentError):
        return f"{error.token.keyword} is given more than once"
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        return f"{error.keyword} needs a value" if error.keyword else f"{error.argument.name} is missing"
    if isinstance(error, CoercionError) and error.token is not None and error.msg is None:
        name = error.token.keyword or (error.argument.name if error.argument else "")
        return f"{name}: must be {_allowed(error.target_type)}, not {error.token.value!r}"
    return str(error)


def _allowed(kind: Any) -> str:
    """Return what may be typed where a type is wanted."""
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(_allowed(member) for member in get_args(kind))
    if get_origin(kind) is Literal:
        return " or ".join(get_args(kind))
    if get_origin(kind) is tuple:  # of any length
        return _allowed(get_args(kind)[0])
    return {int: "a whole number", float: "a number", bool: "yes or no", NoneType: "none"}.get(kind, "a text")
