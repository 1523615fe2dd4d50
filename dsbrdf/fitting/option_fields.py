"""Declare options as a frozen dataclass whose fields have a sentence, bounds and a default."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import wraps
from typing import Any, TypeVar

from dsbrdf.errors import InvalidArgumentError

Options = TypeVar("Options")


@dataclass(frozen=True)
class Bounds:
    """Bound the number of an option, or every number of a list; the annotation of the option contains the bounds."""

    least: float
    most: float
    above: bool = False  # whether the lower bound itself is excluded

    def allow(self, number: float) -> bool:
        """Tell whether a number is within the bounds."""
        return (self.least < number if self.above else self.least <= number) and number <= self.most

    def __str__(self) -> str:
        return (
            f"above {self.least:g} and at most {self.most:g}" if self.above else f"from {self.least:g} to {self.most:g}"
        )

    def __get_pydantic_json_schema__(
        self, core_schema: Any, handler: Callable[[Any], dict[str, Any]]
    ) -> dict[str, Any]:
        """Add the bounds to the schema of the HTTP interface, as pydantic asks."""
        schema = handler(core_schema)
        bounds = {"exclusiveMinimum" if self.above else "minimum": self.least, "maximum": self.most}
        if schema.get("type") != "array":
            return schema | bounds
        several = {"minItems": 2, "maxItems": int(self.most - self.least) + 1, "uniqueItems": True}
        return schema | several | {"items": schema["items"] | bounds}


def option(default: Any, doc: str) -> Any:
    """Return a field of a class of options; the docstring, command line and HTTP reference contain its sentence."""
    return field(default=default, metadata={"doc": doc})


def sentences_of(options: type) -> dict[str, str]:
    """Return the sentence that documents each option of a class of options, by the name of the option."""
    return {declared.name: declared.metadata["doc"] for declared in fields(options)}


def documented(options: type[Options]) -> type[Options]:
    """Add the sentence of each option of a class to the docstring of the class, without inherited options."""
    lines = [*inspect.cleandoc(options.__doc__ or "").splitlines(), "", "Attributes", "----------"]
    sentences = sentences_of(options)
    for name in options.__annotations__:
        lines += [name, *textwrap.wrap(sentences[name], 112, initial_indent="    ", subsequent_indent="    ")]
    options.__doc__ = "\n".join(lines)
    return options


def suggesting(options: type[Options]) -> type[Options]:
    """Make a dataclass of options refuse a wrong name of an option, and suggest the right name."""
    init: Callable[..., None] = options.__init__
    names = [declared.name for declared in fields(options)]  # type: ignore[arg-type]  # The class is a dataclass.

    @wraps(init)
    def checked(self: Options, *values: object, **choices: object) -> None:
        check_names(choices, names)
        init(self, *values, **choices)

    options.__init__ = checked  # type: ignore[assignment, method-assign]
    return options


def check_names(choices: Iterable[str], known: Sequence[str]) -> None:
    """Raise InvalidArgumentError for the first unknown name of an option, and suggest a known name."""
    for name in choices:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            rest = f"did you mean {near[0]}?" if near else f"the options are {', '.join(known)}"
            raise InvalidArgumentError(f"there is no option {name!r}; {rest}")
