"""The fields of `FitOptions` as command line options, with names, types and help taken from the dataclass."""

import argparse
import inspect
import re
from collections.abc import Callable
from dataclasses import Field, fields
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from dsbrdf.fitting.options import FitOptions

ANGLE_FIELDS = frozenset({"horizon_cutoff", "knots"})
"""Fields in radians; on the command line they are in degrees."""

_PLACEHOLDERS = {int: ("N",), float: ("N",), tuple: ("N,N,...",)}


def add_fit_options(parser: argparse.ArgumentParser) -> None:
    """Add one option for each field of `FitOptions`."""
    hints, texts = get_type_hints(FitOptions), _field_descriptions()
    group = parser.add_argument_group("options of the fit")
    for field in fields(FitOptions):
        _add_option(group, field, hints[field.name], texts.get(field.name, ""))


def fit_options(arguments: argparse.Namespace) -> FitOptions:
    """Return the options that the command line gives; the others keep the defaults of `FitOptions`.

    Raises
    ------
    InvalidArgumentError
        If a value is out of range.
    """
    given = {field.name: getattr(arguments, field.name) for field in fields(FitOptions) if field.name in arguments}
    return FitOptions(**given)


def _add_option(group: argparse._ArgumentGroup, field: Field[Any], hint: Any, text: str) -> None:
    name = field.name.replace("_", "-")
    in_degrees = field.name in ANGLE_FIELDS
    help_text = f"{text} (default: {_as_typed(field.default, in_degrees=in_degrees)})"
    for written, typed in (("[rad]", "[degrees]"), ("`", ""), ("None", "none"), ("%", "%%")):
        help_text = help_text.replace(written, typed)
    if hint is bool:
        group.add_argument(
            f"--{name}",
            dest=field.name,
            action=argparse.BooleanOptionalAction,
            default=argparse.SUPPRESS,
            help=help_text,
        )
        return
    types = _types(hint)
    group.add_argument(
        f"--{name}",
        dest=field.name,
        type=_converter(types, in_degrees=in_degrees),
        default=argparse.SUPPRESS,
        metavar="|".join([*_words(types), *_PLACEHOLDERS.get(_numeric_type(types), ())]),
        help=help_text,
    )


def _as_typed(value: Any, *, in_degrees: bool) -> str:
    """Return a default value as a user would type it."""
    if isinstance(value, tuple):
        return ",".join(_as_typed(item, in_degrees=in_degrees) for item in value)
    if isinstance(value, float):
        return f"{np.degrees(value) if in_degrees else value:g}"
    return str(value).lower()


def _types(hint: Any) -> tuple[Any, ...]:
    """Return the types of which a value may be: the members of a union, or the type itself."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _words(types: tuple[Any, ...]) -> dict[str, Any]:
    """Return the words that may be given, with their values: those of a Literal, and ``none``."""
    words = {word: word for kind in types if get_origin(kind) is Literal for word in get_args(kind)}
    return words | ({"none": None} if NoneType in types else {})


def _numeric_type(types: tuple[Any, ...]) -> Any:
    """Return the numeric type that is allowed, int, float or tuple; None where only words are."""
    return next((kind for kind in ((get_origin(k) or k) for k in types) if kind in (int, float, tuple)), None)


def _converter(types: tuple[Any, ...], *, in_degrees: bool) -> Callable[[str], Any]:
    """Return the function that converts the text of an option to its value."""
    words, number = _words(types), _numeric_type(types)
    names = {int: "a whole number", float: "a number", tuple: "numbers separated by commas"}
    allowed = " or ".join([*words, *([] if number is None else [names[number]])])

    def convert(text: str) -> Any:
        if text in words:
            return words[text]
        try:
            if number is int:
                return int(text)
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if number is None or not values or (number is float and len(values) > 1):
            raise argparse.ArgumentTypeError(f"must be {allowed}, not {text!r}")
        if in_degrees:
            values = tuple(float(np.radians(value)) for value in values)
        return values if number is tuple else values[0]

    return convert


def _field_descriptions() -> dict[str, str]:
    """Return the description of each field from the docstring of `FitOptions`."""
    text = inspect.getdoc(FitOptions) or ""  # without the indentation, which Python 3.13 removes and older ones keep
    entries = re.findall(r"^(\w+) : .*\n((?:    .+(?:\n|$))+)", text, flags=re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}
