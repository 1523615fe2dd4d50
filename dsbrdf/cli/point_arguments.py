"""Points on the command line: half and difference angles in degrees, or pairs of directions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from cyclopts import Group, Parameter, Token, convert
from numpy.typing import NDArray

from dsbrdf.errors import InvalidArgumentError

Array = NDArray[np.float64]


def _each(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert the numbers of an option, which `dsbrdf.cli.arguments.join_points` has joined."""
    return convert(kind, [token.evolve(value=number) for token in tokens for number in token.value.split()])


_Angles = Annotated[tuple[float, ...], Parameter(metavar="DEGREES...", converter=_each)]
_Directions = Annotated[tuple[str, ...], Parameter(metavar="X,Y,Z...", converter=_each)]


@Parameter(name="*", group=Group("Points", sort_key=2))
@dataclass(frozen=True)
class Points:
    """Values of the options that name points.

    Attributes
    ----------
    theta_half
        An angle, or several.
    theta_diff
        An angle, or several.
    phi_diff
        An angle, or several; by default 90, where both directions make the same angle with the normal.
    omega_in
        A unit vector, or several.
    omega_out
        A unit vector, or several.
    """

    theta_half: _Angles = ()
    theta_diff: _Angles = ()
    phi_diff: _Angles = ()
    omega_in: _Directions = ()
    omega_out: _Directions = ()

    def arrays(self) -> dict[str, Array]:
        """Return the points.

        Returns
        -------
        dict
            ``theta_half_deg``, ``theta_diff_deg`` and ``phi_diff_deg`` of shape (n,) [degrees], or ``omega_in`` and
            ``omega_out`` of shape (n, 3).  What is given once is combined with all values of the others.

        Raises
        ------
        InvalidArgumentError
            If an angle or a direction is missing or is none, angles and directions are mixed, or numbers differ and
            are not 1.
        """
        by_angles = self.theta_half or self.theta_diff or self.phi_diff
        if by_angles and (self.omega_in or self.omega_out):
            raise InvalidArgumentError("give either --theta-half and --theta-diff or --omega-in and --omega-out")
        if self.omega_in or self.omega_out:
            columns = {
                "omega_in": _given("omega_in", [_direction(text) for text in self.omega_in]),
                "omega_out": _given("omega_out", [_direction(text) for text in self.omega_out]),
            }
        else:
            columns = {
                "theta_half_deg": _given("theta_half", self.theta_half),
                "theta_diff_deg": _given("theta_diff", self.theta_diff),
                "phi_diff_deg": np.array(self.phi_diff or [90.0]),
            }
        length = max(len(array) for array in columns.values())
        if any(len(array) not in (1, length) for array in columns.values()):
            counts = ", ".join(f"{len(array)} {name}" for name, array in columns.items())
            raise InvalidArgumentError(f"{counts} cannot be combined: give equally many of each, or one")
        return {name: np.repeat(array, length // len(array), axis=0) for name, array in columns.items()}


def _given(name: str, values: Sequence[object]) -> Array:
    if not values:
        raise InvalidArgumentError(f"--{name.replace('_', '-')} is missing: a point needs both")
    return np.array(values, dtype=np.float64)


def _direction(text: str) -> list[float]:
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise InvalidArgumentError(f"a direction must be three numbers x,y,z, not {text!r}") from None
    return [x, y, z]
