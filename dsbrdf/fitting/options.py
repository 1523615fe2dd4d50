"""Define the options of a fit: a frozen dataclass whose fields have a sentence, bounds and a default."""

import inspect
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import cache, wraps
from itertools import pairwise
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from dsbrdf.data.geometry import THETA_DIFF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.lobes import Family

Options = TypeVar("Options")


@dataclass(frozen=True)
class Bounds:
    """Bound the number of an option, or every number of a list; the annotation of the option contains the bounds."""

    minimum: float
    maximum: float
    above: bool = False  # whether the lower bound itself is excluded

    def allow(self, number: float) -> bool:
        """Tell whether a number is within the bounds."""
        return (self.minimum < number if self.above else self.minimum <= number) and number <= self.maximum

    def __str__(self) -> str:
        return (
            f"above {self.minimum:g} and at most {self.maximum:g}"
            if self.above
            else f"from {self.minimum:g} to {self.maximum:g}"
        )

    def __get_pydantic_json_schema__(
        self, core_schema: Any, handler: Callable[[Any], dict[str, Any]]
    ) -> dict[str, Any]:
        """Add the bounds to the schema of the HTTP interface, as pydantic asks."""
        schema = handler(core_schema)
        bounds = {"exclusiveMinimum" if self.above else "minimum": self.minimum, "maximum": self.maximum}
        if schema.get("type") != "array":
            return schema | bounds
        several = {"minItems": 2, "maxItems": int(self.maximum - self.minimum) + 1, "uniqueItems": True}
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


MAX_LOBES = 10
MAX_RING_LOBES = MAX_LOBES - 1
OPTION_DECIMALS = 9
"""Options are rounded to this number of decimals: conversions to radians and back change later digits."""
# The choices that the method "paper" allows for some options, and the end of the error message for any other choice.
_PAPER_CHOICES: dict[str, tuple[tuple[object, ...], str]] = {
    "ring_lobes": (("auto", 0), 'has no ring lobes: use ring_lobes 0 or "auto"'),
    "knots_deg": (("auto",), "has its slices every 5 degrees: leave the knots out"),
    "variation": (("full",), 'has values at every slice: use the variation "full"'),
    "lobe": (("hemi_epd",), 'has the lobe "hemi_epd" only'),
    "weighting": (("auto", "plain", "cosine", "log"), 'has no weighting "balanced": use "plain", "cosine" or "log"'),
}
Weighting = Literal["auto", "balanced", "plain", "cosine", "log"]
"""Weights of the samples, see `dsbrdf.data.reduction`; "auto" leaves the choice to the method."""


@documented
@suggesting
@dataclass(frozen=True)
class FitOptions:
    """Choose how a measurement is fitted; every choice is checked.

    "auto" leaves a choice to the library; None switches something off, as in ``horizon_cutoff_deg=None``.

    Raises
    ------
    InvalidArgumentError
        If a choice is unknown or out of range.
    """

    n_lobes: Annotated[int, Bounds(1, MAX_LOBES)] | Literal["auto"] = option(
        "auto",
        'Number of all lobes, 1 to 10. "auto" takes 9, or fewer if the rest is noise or negligible; with the method '
        '"paper" it takes the smallest number from 1 to 5 that Williams\' test does not find worse than 5.',
    )
    method: Literal["global", "paper"] = option(
        "global",
        '"global" fits all theta_diff at once; "paper" is Algorithm 1 of Nishino 2009, which fits one theta_diff after '
        "another.",
    )
    ring_lobes: Annotated[int, Bounds(0, MAX_RING_LOBES)] | Literal["auto"] = option(
        "auto",
        'Number of lobes whose center is not 0, from 0 to 9 and below n_lobes; "auto" takes the number that explains '
        'most. The method "paper" has none.',
    )
    lobe: Family = option(
        "hemi_epd", '"hemi_epd" is the lobe of the paper and of the method "paper"; "student" has heavier tails.'
    )
    knots_deg: Annotated[tuple[int, ...], Bounds(0, THETA_DIFF.size - 1)] | Literal["auto"] = option(
        "auto",
        'Angles theta_diff at which the method "global" stores the amplitudes: increasing whole degrees. "auto" takes '
        '7 angles that lie closer towards grazing, or 3 with the variation "parametric".',
    )
    variation: Literal["full", "parametric"] = option(
        "full",
        'How lobes change with theta_diff: "full" stores them at several knots, with the method "paper" at every '
        'slice; "parametric" stores 5 coefficients of the amplitude for each channel, and one shape for all '
        "theta_diff. It has a third of the numbers and about a third more error.",
    )
    horizon_cutoff_deg: Annotated[float, Bounds(0, 90, above=True)] | None = option(
        80.0,
        "Largest angle of a direction to the normal [degrees]. Samples beyond it are left out of the metrics and of "
        'the method "paper"; the method "global" gives them less weight, down to 0 at the horizon. None takes all.',
    )
    mask: Annotated[float, Bounds(0, 10)] | Literal["auto"] = option(
        "auto",
        "Keep theta_half <= 90 degrees - mask * theta_diff (Nishino 2009, section 6); 0 keeps all. "
        '"auto" is 0 for the method "global" and 1 for "paper".',
    )
    weighting: Weighting = option(
        "auto",
        'Weights of the samples, compared in "Which weighting, how many lobes" of the documentation. "auto" takes '
        '"balanced" for the method "global", and "plain" for "paper", which has no "balanced".',
    )
    robust: bool = option(
        False, "Give outliers less weight, among the samples over phi_diff and in the residuals over theta_half."
    )
    em_iterations: Annotated[int, Bounds(1, 10_000)] = option(100, "Maximum number of iterations of Algorithm 1.")

    def __post_init__(self) -> None:
        for name, (kind, bounds, words) in _declared().items():
            value = getattr(self, name)
            if isinstance(value, np.generic):  # NumPy numbers are converted to Python numbers.
                value = value.item()
            if value not in words:
                value = _checked(name, value, kind, bounds, words)
            object.__setattr__(self, name, value)
        if self.n_lobes != "auto" and self.ring_lobes != "auto" and self.ring_lobes >= self.n_lobes:
            raise InvalidArgumentError(
                f"ring_lobes must be below n_lobes, at most {self.n_lobes - 1} here, not {self.ring_lobes}: "
                "a ring lobe is one of the lobes"
            )
        for name, (possible, why) in _PAPER_CHOICES.items():
            if self.method == "paper" and getattr(self, name) not in possible:
                raise InvalidArgumentError(f'the method "paper" {why}')

    @property
    def horizon_cutoff(self) -> float | None:
        """Maximum angle of a direction to the normal [rad], or None."""
        return None if self.horizon_cutoff_deg is None else float(np.radians(self.horizon_cutoff_deg))

    @property
    def knots(self) -> tuple[float, ...] | None:
        """The chosen knots of the amplitudes [rad], or None if the method chooses them."""
        return None if self.knots_deg == "auto" else tuple(np.radians(self.knots_deg).tolist())

    @property
    def resolved_weighting(self) -> str:
        """The chosen weighting, or the method's own weighting if the choice is "auto"."""
        return ("plain" if self.method == "paper" else "balanced") if self.weighting == "auto" else self.weighting

    @property
    def resolved_mask(self) -> float:
        """The chosen mask, or the method's own mask if the choice is "auto"."""
        return (1.0 if self.method == "paper" else 0.0) if self.mask == "auto" else self.mask


def _checked(name: str, value: Any, kind: type | None, bounds: Bounds | None, words: tuple[str | None, ...]) -> Any:
    """Return a value in its option's type; raise InvalidArgumentError if the option does not allow it."""
    if kind is bool:
        right = "true or false"
        if isinstance(value, bool):
            return value
    elif bounds is None:
        right = f"one of {', '.join(filter(None, words))}"
    elif kind is int:
        right = f"an integer {bounds}"
        if isinstance(value, int) and not isinstance(value, bool) and bounds.allow(value):
            return value
    elif kind is float:
        right = f"a number {bounds}"
        if (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and bounds.allow(round(value, OPTION_DECIMALS))
        ):
            return round(float(value), OPTION_DECIMALS)
    else:
        right = f"at least two increasing whole numbers {bounds}"
        if isinstance(value, list | tuple | np.ndarray):
            items = [item.item() if isinstance(item, np.generic) else item for item in value]
            if all(type(item) in (int, float) and bounds.allow(item) and item == int(item) for item in items):
                rising = all(first < second for first, second in pairwise(items))
                if len(items) > 1 and rising:
                    return tuple(int(item) for item in items)
    instead = ' or "auto"' if bounds is not None and "auto" in words else ""
    raise InvalidArgumentError(f"{name} must be {right}{instead}, not {repr(value)[:60]}")


@cache
def _declared() -> dict[str, tuple[type | None, Bounds | None, tuple[str | None, ...]]]:
    """Return for each option the type and the bounds of its numbers, and the words that it allows."""
    found: dict[str, tuple[type | None, Bounds | None, tuple[str | None, ...]]] = {}
    for name, hint in get_type_hints(FitOptions, include_extras=True).items():
        kind: type | None = bool if hint is bool else None
        bounds: Bounds | None = None
        words: tuple[str | None, ...] = ()
        for part in (hint,) if get_origin(hint) in (Annotated, Literal) else get_args(hint):
            if get_origin(part) is Annotated:
                inner, bounds = get_args(part)
                kind = get_origin(inner) or inner
            elif get_origin(part) is Literal:
                words = get_args(part)
            elif part is NoneType:
                words = (*words, None)
        found[name] = kind, bounds, words
    return found
