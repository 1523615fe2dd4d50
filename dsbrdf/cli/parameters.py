"""Parameters of commands with their help, placeholders and other names; options of a fit, and points, in degrees."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import CoercionError, Group, Parameter, Token, convert
from numpy.typing import ArrayLike, NDArray

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.output.export import PARTS

Array = NDArray[np.float64]


def _whole_number(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert as cyclopts does, but refuse 2.5, which it would round."""
    (token,) = tokens
    if "." in token.value:
        raise CoercionError(token=token, target_type=kind)
    return convert(kind, tokens)


Whole = Parameter(converter=_whole_number, metavar="N")
ModelFile = Annotated[Path, Parameter(help="A .json or .npz file from dsbrdf fit.")]
SourceFile = Annotated[Path, Parameter(help="A .json or .npz model, or a .binary or .bsdf measurement.")]
RequiredFiles = Annotated[Path, Parameter(required=True)]
OutputFile = Annotated[Path, Parameter(alias="-o", metavar="FILE")]
OutputFolder = Annotated[Path, Parameter(alias="-o", metavar="DIR")]
Component = Annotated[
    str | None,
    Parameter(choices=PARTS, help="One component, or the guide (all components' own lobes), instead of the model."),
]
Jobs = Annotated[int | None, Whole]
Json = Annotated[bool, Parameter(help="Print one JSON document instead of text.")]


def _radians(kind: Any, tokens: Sequence[Token]) -> float | tuple[float, ...] | None:
    """Convert an angle, or several with commas, from the degrees of the command line to the radians of the option."""
    (token,) = tokens
    if token.value == "none":
        return None
    if kind is float:
        return float(np.radians(convert(float, tokens)))
    degrees = [convert(float, [token.evolve(value=part)]) for part in re.split(r"[,\s]+", token.value)]
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


def _each(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert the values of an option, which `dsbrdf.cli.arguments.join_points` has joined."""
    between = r"[,\s]+" if kind == tuple[float, ...] else r"\s+"  # a direction has commas of its own
    values = (value for token in tokens for value in re.split(between, token.value.strip()))
    return convert(kind, [tokens[0].evolve(value=value) for value in values])


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
    theta_in
        Angle of omega_in to the normal, or several.
    theta_out
        Angle of omega_out to the normal, or several.
    phi_out
        Azimuth of omega_out, that of omega_in being 0; by default 180, the side of the mirror direction.
    omega_in
        A unit vector, or several.
    omega_out
        A unit vector, or several.
    """

    theta_half: _Angles = ()
    theta_diff: _Angles = ()
    phi_diff: _Angles = ()
    theta_in: _Angles = ()
    theta_out: _Angles = ()
    phi_out: _Angles = ()
    omega_in: _Directions = ()
    omega_out: _Directions = ()

    def arrays(self) -> dict[str, Array]:
        """Return the points.

        Returns
        -------
        dict
            ``theta_half_deg``, ``theta_diff_deg`` and ``phi_diff_deg`` of shape (n,) [degrees], or ``theta_in_deg``,
            ``theta_out_deg`` and ``phi_out_deg``, or ``omega_in`` and ``omega_out`` of shape (n, 3).  What is given
            once is combined with all values of the others.

        Raises
        ------
        InvalidArgumentError
            If an angle or a direction is missing or is none, ways to name points are mixed, or numbers differ and are
            not 1.
        """
        half = self.theta_half or self.theta_diff or self.phi_diff
        polar = self.theta_in or self.theta_out or self.phi_out
        vectors = self.omega_in or self.omega_out
        if sum(map(bool, (half, polar, vectors))) > 1:
            raise InvalidArgumentError(
                "give either --theta-half and --theta-diff, --theta-in and --theta-out, or --omega-in and --omega-out"
            )
        if polar:
            columns = {
                "theta_in_deg": _given("theta_in", self.theta_in),
                "theta_out_deg": _given("theta_out", self.theta_out),
                "phi_out_deg": np.array(self.phi_out or [180.0]),
            }
        elif vectors:
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


def direction(theta_deg: Array, phi_deg: ArrayLike) -> Array:
    """Return unit vectors (n, 3) of angles to the normal and azimuths [degrees]."""
    theta, phi = np.broadcast_arrays(np.radians(theta_deg), np.radians(phi_deg))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


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
