"""Define the options for reading a table of scattered samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import Bounds, documented, option, suggesting

_SCALES = Bounds(1e-12, 1e12)


@documented
@suggesting
@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """Choose how a table of scattered samples is read; every choice is checked.

    `columns` and `constants` may also be dicts.

    Raises
    ------
    InvalidArgumentError
        If a choice is unknown or out of range.
    """

    columns: tuple[str, ...] | str = option(
        (),
        'Meanings of columns whose names are not understood: "theta_in=AOI,value=3" reads theta_in from the column AOI '
        "and the values from the third column.",
    )
    constants: tuple[str, ...] | str = option(
        (), 'Angles [degrees] that are equal in all rows: "theta_in=30,phi_in=0".'
    )
    missing: tuple[float, ...] | float = option(
        (), "Numbers that stand for a missing value, such as 0 or -999: their rows are left out."
    )
    scale: Annotated[float, _SCALES] = option(
        1.0, "Factor that makes the values a BRDF in 1/sr: 0.003183, or 0.01 / pi, for reflectance factors in per cent."
    )
    cosine: Literal["in", "out"] | None = option(
        None,
        '"in" or "out" if the values are the BRDF times the cosine of theta_in or theta_out, which divides them.',
    )
    phi: Literal["mirror"] | None = option(
        None,
        '"mirror" if light and viewer have the same phi in the mirror direction, as in ASTM E1392; otherwise they are '
        '180 degrees apart. Without a column phi, "mirror" means that theta_out = -theta_in is the mirror direction.',
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", _pairs("columns", self.columns, "theta_in=AOI,value=BSDF"))
        object.__setattr__(self, "constants", _pairs("constants", self.constants, "theta_in=30,phi_in=0"))
        if not all(map(math.isfinite, self.held().values())):
            raise InvalidArgumentError("constants must be finite numbers")
        given = self.missing if isinstance(self.missing, list | tuple) else (self.missing,)
        if not all(_is_number(number) for number in given):
            raise InvalidArgumentError(f"missing must be finite numbers, not {repr(self.missing)[:60]}")
        object.__setattr__(self, "missing", tuple(map(float, given)))
        if not _is_number(self.scale) or not _SCALES.allow(self.scale):
            raise InvalidArgumentError(f"scale must be a number {_SCALES}, not {repr(self.scale)[:60]}")
        object.__setattr__(self, "scale", float(self.scale))
        for name, words in (("cosine", ("in", "out")), ("phi", ("mirror",))):
            value = getattr(self, name)
            if value is not None and value not in words:
                raise InvalidArgumentError(f"{name} must be one of {', '.join(words)}, not {repr(value)[:60]}")

    @classmethod
    def chosen(cls, options: TableOptions | None, choices: dict[str, Any]) -> TableOptions:
        """Return `options`, or options made from `choices` by name; raise InvalidArgumentError if both are given."""
        if options is not None and choices:
            raise InvalidArgumentError("give the options as TableOptions or by name, not both")
        return options or cls(**choices)

    def named_columns(self) -> dict[str, str]:
        """Return the option `columns` as a dict: the name of a column for each meaning, such as theta_in."""
        return dict(_parts(pair) for pair in self.columns)

    def held(self) -> dict[str, float]:
        """Return the option `constants` as a dict: a number for each meaning, such as theta_in."""
        numbers = {}
        for meaning, text in map(_parts, self.constants):
            try:
                numbers[meaning] = float(text)
            except ValueError:
                raise InvalidArgumentError(f"constants must be numbers, not {text[:60]!r} for {meaning}") from None
        return numbers

    def refuse(self, what: str) -> None:
        """Raise InvalidArgumentError if an option is set; `what`, such as "a MERL file", is read without options."""
        chosen = [one.name for one in fields(self) if getattr(self, one.name) != one.default]
        if chosen:
            are = f"{', '.join(chosen)} {'is an option' if len(chosen) == 1 else 'are options'} of a table of samples"
            raise InvalidArgumentError(f"{are}, and this is {what}: leave {' and '.join(chosen)} out")


def _pairs(option_name: str, given: Any, example: str) -> tuple[str, ...]:
    if isinstance(given, Mapping) and all(_is_number(text) or isinstance(text, str) for text in given.values()):
        given = [f"{meaning}={text}" for meaning, text in given.items()]
    pairs = given.split(",") if isinstance(given, str) else given
    if isinstance(pairs, list | tuple) and all(isinstance(pair, str) and all(_parts(pair)) for pair in pairs):
        return tuple("=".join(_parts(pair)) for pair in pairs)
    raise InvalidArgumentError(f"{option_name} must be such as {example}, not {str(given)[:60]!r}")


def _parts(pair: str) -> tuple[str, str]:
    meaning, _, name = pair.partition("=")
    return meaning.strip(), name.strip()


def _is_number(value: Any) -> bool:
    try:
        return not isinstance(value, bool | str) and math.isfinite(value)
    except (TypeError, OverflowError):  # A value may be no number, or too large for a float, such as 10**400.
        return False


AS_WRITTEN = TableOptions()
"""The default options, for a table that is read as it is written."""
TABLE_OPTIONS = tuple(declared.name for declared in fields(TableOptions))
"""Names of the options for reading a table."""
