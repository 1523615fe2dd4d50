"""What can be chosen about how a table of scattered samples is read."""

from __future__ import annotations

import inspect
import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, TypeVar

from dsbrdf.errors import InvalidArgumentError

Options = TypeVar("Options")


@dataclass(frozen=True)
class Bounds:
    """The smallest and largest number that an option, or each of a list, may be; stands in its annotation."""

    least: float
    most: float
    above: bool = False  # the least itself is too small

    def allow(self, number: float) -> bool:
        """Whether a number is within the bounds."""
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
    """Return a field of a class of options; its sentence goes to the docstring, the command line and over HTTP."""
    return field(default=default, metadata={"doc": doc})


def sentences_of(options: type) -> dict[str, str]:
    """Return what each option of a class means."""
    return {declared.name: declared.metadata["doc"] for declared in fields(options)}


def documented(options: type[Options]) -> type[Options]:
    """Add the sentences of a class's own options to its docstring."""
    lines = [*inspect.cleandoc(options.__doc__ or "").splitlines(), "", "Attributes", "----------"]
    sentences = sentences_of(options)
    for name in options.__annotations__:
        lines += [name, *textwrap.wrap(sentences[name], 112, initial_indent="    ", subsequent_indent="    ")]
    options.__doc__ = "\n".join(lines)
    return options


_SCALES = Bounds(1e-12, 1e12)


@documented
@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """How a table of scattered samples is read; checked when made.

    Raises
    ------
    InvalidArgumentError
        If a choice is unknown or out of range.
    """

    columns: tuple[str, ...] | str = option(
        (),
        'What a column means whose name does not say it: with "theta_in=AOI", the column AOI has the angles theta_in. '
        "Several are separated by commas; in Python they may be a dict.",
    )
    missing: tuple[float, ...] | float = option(
        (), "Numbers that stand for a missing value, such as 0 or -999: their rows are left out."
    )
    scale: Annotated[float, _SCALES] = option(
        1.0,
        "What the values are multiplied by to be those of a BRDF in 1/sr: 0.01 / pi for reflectance factors in "
        "per cent.",
    )
    cosine: Literal["in", "out"] | None = option(
        None,
        '"in" or "out" if the values are the BRDF times the cosine of theta_in or of theta_out: they are divided by '
        "it.",
    )
    phi: Literal["mirror"] | None = option(
        None,
        '"mirror" if light and viewer have the same phi in the mirror direction, as in ASTM E1392; otherwise they are '
        '180 degrees apart. Without a column phi, "mirror" means that theta_out = -theta_in is the mirror direction.',
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", _columns(self.columns))
        given = self.missing if isinstance(self.missing, list | tuple) else (self.missing,)
        if not all(_is_number(number) for number in given):
            raise InvalidArgumentError(f"missing must be finite numbers, not {str(self.missing)[:60]}")
        object.__setattr__(self, "missing", tuple(map(float, given)))
        if not _is_number(self.scale) or not _SCALES.allow(self.scale):
            raise InvalidArgumentError(f"scale must be a number {_SCALES}, not {repr(self.scale)[:60]}")
        object.__setattr__(self, "scale", float(self.scale))
        for name, words in (("cosine", ("in", "out")), ("phi", ("mirror",))):
            value = getattr(self, name)
            if value is not None and value not in words:
                raise InvalidArgumentError(f"{name} must be one of {', '.join(words)}, not {repr(value)[:60]}")

    def of_table(self) -> TableOptions:
        """Return these options alone, without what a class that has more of them adds."""
        return TableOptions(**{declared.name: getattr(self, declared.name) for declared in fields(TableOptions)})

    def named_columns(self) -> dict[str, str]:
        """Return the name of the column with each meaning that `columns` gives."""
        return dict(_parts(pair) for pair in self.columns)

    def refuse_on_grid(self) -> None:
        """Raise InvalidArgumentError if one of them is chosen: a measurement on a grid has none."""
        for declared in fields(TableOptions):
            if getattr(self, declared.name) != declared.default:
                raise InvalidArgumentError(
                    f"{declared.name} is for scattered samples; leave it out for a measurement on a grid"
                )


def _columns(given: Any) -> tuple[str, ...]:
    if isinstance(given, Mapping) and all(isinstance(name, str) for name in given.values()):
        given = [f"{meaning}={name}" for meaning, name in given.items()]
    pairs = given.split(",") if isinstance(given, str) else given
    right = isinstance(pairs, list | tuple) and all(isinstance(pair, str) and all(_parts(pair)) for pair in pairs)
    if not right:
        raise InvalidArgumentError(f"columns must be such as theta_in=AOI,value=BSDF, not {str(given)[:60]!r}")
    return tuple("=".join(_parts(pair)) for pair in pairs)


def _parts(pair: str) -> tuple[str, str]:
    meaning, _, name = pair.partition("=")
    return meaning.strip(), name.strip()


def _is_number(value: Any) -> bool:
    try:
        return not isinstance(value, bool | str) and math.isfinite(value)
    except (TypeError, OverflowError):  # such as 10**400
        return False


AS_WRITTEN = TableOptions()
"""The table says everything itself."""
