"""The fields of `FitOptions` as command line flags: names, kinds and help all come from the dataclass."""

import argparse
import inspect
import re
from collections.abc import Callable
from dataclasses import Field, fields
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from dsbrdf.fitting.options import FitOptions

ANGLES = frozenset({"horizon_cutoff", "knots"})
"""Fields in radians; on the command line they are in degrees."""

_NUMBERS = {int: ("N",), float: ("N",), tuple: ("N,N,...",)}


def add_fit_flags(parser: argparse.ArgumentParser) -> None:
    """Give the parser one flag for each field of `FitOptions`."""
    hints, texts = get_type_hints(FitOptions), _field_texts()
    group = parser.add_argument_group("options of the fit")
    for field in fields(FitOptions):
        _add_flag(group, field, hints[field.name], texts.get(field.name, ""))


def fit_options(arguments: argparse.Namespace) -> FitOptions:
    """Return the options that the flags ask for; what was not given keeps the default of `FitOptions`.

    Raises
    ------
    InvalidArgumentError
        If a value is out of range.
    """
    given = {field.name: getattr(arguments, field.name) for field in fields(FitOptions) if field.name in arguments}
    return FitOptions(**given)


def scheduler_address(text: str) -> str:
    """Return the text of a flag if it can be the address of a Dask scheduler."""
    if re.fullmatch(r"(tcp|tls|ws|wss)://[^/\s]+:[0-9]+", text) is None:
        raise argparse.ArgumentTypeError(f"must be an address such as tcp://host:8786, not {text!r}")
    return text


def _add_flag(group: argparse._ArgumentGroup, field: Field[Any], hint: Any, text: str) -> None:
    name = "lobes" if field.name == "n_lobes" else field.name.replace("_", "-")
    in_degrees = field.name in ANGLES
    help_text = f"{text} (default: {_shown(field.default, in_degrees=in_degrees)})"
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
    kinds = _kinds(hint)
    group.add_argument(
        f"--{name}",
        dest=field.name,
        type=_converter(kinds, in_degrees=in_degrees),
        default=argparse.SUPPRESS,
        metavar="|".join([*_words(kinds), *_NUMBERS.get(_number(kinds), ())]),
        help=help_text,
    )


def _shown(value: Any, *, in_degrees: bool) -> str:
    """Return a default as it would be typed."""
    if isinstance(value, tuple):
        return ",".join(_shown(item, in_degrees=in_degrees) for item in value)
    if isinstance(value, float):
        return f"{np.degrees(value) if in_degrees else value:g}"
    return str(value).lower()


def _kinds(hint: Any) -> tuple[Any, ...]:
    """Members of a union, or the hint alone."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _words(kinds: tuple[Any, ...]) -> dict[str, Any]:
    """Words that stand for a value: those of a Literal, and ``none``."""
    words = {word: word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)}
    return words | ({"none": None} if NoneType in kinds else {})


def _number(kinds: tuple[Any, ...]) -> Any:
    """int, float or tuple; None where only words are allowed."""
    return next((kind for kind in ((get_origin(k) or k) for k in kinds) if kind in (int, float, tuple)), None)


def _converter(kinds: tuple[Any, ...], *, in_degrees: bool) -> Callable[[str], Any]:
    """Return the function from the text of a flag to its value."""
    words, number = _words(kinds), _number(kinds)
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


whole_number = _converter((int,), in_degrees=False)
"""The text of a flag as an int."""


def _field_texts() -> dict[str, str]:
    """What the docstring of `FitOptions` says about each field."""
    text = inspect.getdoc(FitOptions) or ""  # of the same indentation in every version of Python
    entries = re.findall(r"^(\w+) : .*\n((?:    .+(?:\n|$))+)", text, flags=re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}
