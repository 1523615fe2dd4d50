"""What can be chosen about a fit."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from difflib import get_close_matches
from functools import cache, wraps
from typing import Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from dsbrdf.data.geometry import check_horizon_cutoff
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, THETA_DIFF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.lobe_families import Family

MAX_LOBES = 8
MAX_RING_LOBES = MAX_LOBES - 1
MAX_MASK = 10.0
MAX_EM_ITERATIONS = 10_000
_RANGES = {"n_lobes": (1, MAX_LOBES), "ring_lobes": (0, MAX_RING_LOBES), "em_iterations": (1, MAX_EM_ITERATIONS)}
# option -> what it can be with the method "paper", and why
_OF_PAPER: dict[str, tuple[tuple[object, ...], str]] = {
    "ring_lobes": (("auto", 0), 'has no ring lobes: use ring_lobes 0 or "auto"'),
    "knots": ((None,), "has its slices every 5 degrees: leave the knots out"),
    "variation": (("full",), 'has values at every slice: use the variation "full"'),
    "lobe": (("hemi_epd",), 'has the lobe "hemi_epd" only'),
    "weighting": ((None, "plain", "cosine", "log"), 'has no weighting "balanced": use "plain", "cosine" or "log"'),
}
Weighting = Literal["balanced", "plain", "cosine", "log"]
"""Weights of the samples, see `dsbrdf.fitting.weighting`."""

Options = TypeVar("Options")


def _suggesting(options: type[Options]) -> type[Options]:
    """Make a dataclass name the option that a wrong name may mean."""
    init: Callable[..., None] = options.__init__

    @wraps(init)
    def checked(self: Options, *values: object, **choices: object) -> None:
        known = [field.name for field in fields(options)]  # type: ignore[arg-type]  # a dataclass
        for name in choices:
            if name not in known:
                near = get_close_matches(name, known, n=1)
                rest = f"did you mean {near[0]}?" if near else f"the options are {', '.join(known)}"
                raise InvalidArgumentError(f"there is no option {name!r}; {rest}")
        init(self, *values, **choices)

    options.__init__ = checked  # type: ignore[assignment, method-assign]
    return options


@_suggesting
@dataclass(frozen=True)
class FitOptions:
    """What can be chosen about a fit; checked when made.

    Attributes
    ----------
    n_lobes : int or "auto"
        Number of all lobes, 1 to 8; "auto" adds them while they lower the error on samples held out; with the method
        "paper" it is the smallest of 1 to 5 that Williams' test does not find worse than 5.
    method : {"global", "paper"}
        "global" fits all rows of theta_diff at once; "paper" is Algorithm 1 of Nishino 2009 slice by slice.
    ring_lobes : int or "auto"
        How many of the lobes have a center of their own, 0 to 7, fewer than all; "auto" takes what explains most. The
        method "paper" has none.
    lobe : {"hemi_epd", "student"}
        Family of the lobes, see `dsbrdf.model.lobes`; the method "paper" has the hemi-EPD only.
    knots : tuple of float or None
        Angles theta_diff at which the amplitudes of the method "global" have their knots, whole degrees, increasing
        [rad]; None takes 8 that lie closer towards grazing angles, or 3 with the variation "parametric".
    variation : {"full", "parametric"}
        How lobes change with theta_diff. "full" has splines with several knots, with the method "paper" values at every
        slice; "parametric" has 5 coefficients of each channel's amplitude and one shape for all theta_diff: a third of
        the numbers for about a third more error.
    horizon_cutoff : float or None
        Samples with a direction further than this from the normal [rad] are left out of the metrics and of the method
        "paper"; "global" trusts them less, down to nothing at the horizon. None takes all.
    mask : float or None
        Keep theta_half <= 90 degrees - mask * theta_diff (Nishino 2009, section 6); None is the method's own: 0 (no
        mask) for "global", 1 for "paper".
    weighting : {"balanced", "plain", "cosine", "log"} or None
        Weights of the samples, see `dsbrdf.fitting.weighting`; None is the method's own: "balanced" for "global",
        "plain" for "paper", which has no "balanced".
    robust : bool
        Down-weight outliers: among the samples over phi_diff, and in the residuals over theta_half.
    em_iterations : int
        Bound on the iterations of Algorithm 1.
    cosine : {"in", "out"} or None
        The values of scattered samples are the BRDF times the cosine of theta_in or of theta_out, by which the fit
        divides them; None are those of the BRDF. For scattered samples only.

    Raises
    ------
    InvalidArgumentError
        If a choice is unknown or out of range.
    """

    n_lobes: int | Literal["auto"] = "auto"
    method: Literal["global", "paper"] = "global"
    ring_lobes: int | Literal["auto"] = "auto"
    lobe: Family = "hemi_epd"
    knots: tuple[float, ...] | None = None
    variation: Literal["full", "parametric"] = "full"
    horizon_cutoff: float | None = DEFAULT_HORIZON_CUTOFF
    mask: float | None = None
    weighting: Weighting | None = None
    robust: bool = False
    em_iterations: int = 100
    cosine: Literal["in", "out"] | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).copy().items():
            if isinstance(value, np.generic):  # an option taken from an array means the same
                object.__setattr__(self, name, value.item())
        for name in _literals():
            self._check_choice(name)
        if self.n_lobes != "auto" and self.ring_lobes != "auto" and self.ring_lobes >= self.n_lobes:
            raise InvalidArgumentError(
                f"ring_lobes must be below n_lobes, at most {self.n_lobes - 1} here, not {self.ring_lobes}: "
                "a ring lobe is one of the lobes"
            )
        _check_knots(self.knots)
        if self.knots is not None:  # a list of knots means the same
            object.__setattr__(self, "knots", tuple(float(knot) for knot in self.knots))
        for name, (possible, why) in _OF_PAPER.items():
            if self.method == "paper" and getattr(self, name) not in possible:
                raise InvalidArgumentError(f'the method "paper" {why}')
        check_horizon_cutoff(self.horizon_cutoff)
        if self.mask is not None and not 0.0 <= self.mask <= MAX_MASK:
            raise InvalidArgumentError(f"mask must be a number from 0 to {MAX_MASK:g}, not {self.mask!r}")
        if not isinstance(self.robust, bool):
            raise InvalidArgumentError(f"robust must be true or false, not {self.robust!r}")

    def _check_choice(self, name: str) -> None:
        """Check an option that is a whole number or one of the words of its type."""
        value, words = getattr(self, name), _literals()[name]
        if name in _RANGES:
            smallest, largest = _RANGES[name]
            whole = isinstance(value, int) and not isinstance(value, bool) and smallest <= value <= largest
            right = " or ".join([f"an integer from {smallest} to {largest}", *(f'"{word}"' for word in words)])
        else:
            whole, right = value is None and getattr(FitOptions, name) is None, f"one of {', '.join(words)}"
        if not whole and value not in words:
            raise InvalidArgumentError(f"{name} must be {right}, not {value!r}")

    @property
    def resolved_weighting(self) -> str:
        """The weighting, None being the method's own."""
        return self.weighting or ("plain" if self.method == "paper" else "balanced")


def _check_knots(knots: tuple[float, ...] | None) -> None:
    if knots is None:
        return
    degrees = np.degrees(np.asarray(knots, dtype=float))
    whole = np.abs(degrees - np.round(degrees)) < 1e-6
    increasing = degrees.ndim == 1 and 2 <= degrees.size <= THETA_DIFF.size and bool(np.all(np.diff(degrees) > 0))
    if not (increasing and np.all(whole) and degrees[0] > -0.5 and degrees[-1] < 89.5):
        raise InvalidArgumentError("knots must be at least two increasing angles of whole degrees from 0 to 89 degrees")


@cache
def _literals() -> dict[str, tuple[str, ...]]:
    """Words that each option can be whose type has any, or that is a whole number."""
    words = {}
    for name, hint in get_type_hints(FitOptions).items():
        found = [get_args(part) for part in (hint, *get_args(hint)) if get_origin(part) is Literal]
        if found or name in _RANGES:
            words[name] = found[0] if found else ()
    return words
