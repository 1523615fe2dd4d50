"""The fields of `FitOptions` as options of the command line, with the types, the defaults and the help of the class."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Group, Parameter, Token, convert

from dsbrdf.cli.parameters import Whole
from dsbrdf.fitting.options import FitOptions


def _radians(kind: Any, tokens: Sequence[Token]) -> float | tuple[float, ...] | None:
    """Convert an angle, or several with commas, from the degrees of the command line to the radians of the option."""
    (token,) = tokens
    if token.value == "none":
        return None
    if kind is float:
        return float(np.radians(convert(float, tokens)))
    degrees = [convert(float, [token.evolve(value=part)]) for part in token.value.split(",")]
    return tuple(np.radians(degrees).tolist())


def _degrees(radians: float | None) -> str | None:
    """Return an angle as it is shown in the help."""
    return None if radians is None else f"{np.degrees(radians):g}"


_Count = Annotated[int | Literal["auto"], Whole, Parameter(metavar="N|auto", show_choices=False)]
_ANGLE = Parameter(converter=_radians, n_tokens=1, show_default=_degrees, metavar="DEGREES")
_ANGLES = Parameter(converter=_radians, n_tokens=1, show_default=_degrees, metavar="DEGREES,...")


@dataclass(frozen=True)
class FitFlags(FitOptions):
    """`FitOptions` with angles in degrees; a field that is not repeated here is an option as it is."""

    __doc__ = (FitOptions.__doc__ or "").replace("[rad]", "[degrees]").replace("None", "none").replace("`", "")

    n_lobes: _Count = FitOptions.n_lobes
    ring_lobes: _Count = FitOptions.ring_lobes
    knots: Annotated[tuple[float, ...] | None, _ANGLES] = FitOptions.knots
    horizon_cutoff: Annotated[float | None, _ANGLE] = FitOptions.horizon_cutoff
    robust: Annotated[bool, Parameter(negative="--no-robust")] = FitOptions.robust
    em_iterations: Annotated[int, Whole] = FitOptions.em_iterations

    def options(self) -> FitOptions:
        """Return the same as `FitOptions`."""
        return FitOptions(**vars(self))


Flags = Annotated[FitFlags, Parameter(name="*", group=Group("Options of the fit", sort_key=2))]
"""All of them as a parameter of a command."""

DEFAULT = FitFlags()
