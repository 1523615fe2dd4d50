"""Points on the command line: half and difference angles in degrees, or pairs of directions."""

import argparse

import numpy as np
from numpy.typing import NDArray

from dsbrdf.cli.arguments import number
from dsbrdf.errors import InvalidArgumentError

Array = NDArray[np.float64]


def add_point_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name points; `split_points` makes several values of one option one option each."""
    for name, purpose in (
        ("--theta-half", "an angle, or several"),
        ("--theta-diff", "an angle, or several"),
        ("--phi-diff", "an angle, or several (default: 90, where both directions make the same angle with the normal)"),
    ):
        parser.add_argument(name, action="append", type=number, metavar="DEGREES", help=purpose)
    for name in ("--omega-in", "--omega-out"):
        parser.add_argument(name, action="append", type=_direction, metavar="X,Y,Z", help="a unit vector, or several")


def given_points(arguments: argparse.Namespace) -> dict[str, Array]:
    """Return the points that the command line names.

    Returns
    -------
    dict
        ``theta_half_deg``, ``theta_diff_deg`` and ``phi_diff_deg`` of shape (n,) [degrees], or ``omega_in`` and
        ``omega_out`` of shape (n, 3).  What is given once is combined with all values of the others.

    Raises
    ------
    InvalidArgumentError
        If an angle or a direction is missing, angles and directions are mixed, or numbers differ and are not 1.
    """
    by_angles = arguments.theta_half or arguments.theta_diff or arguments.phi_diff
    if by_angles and (arguments.omega_in or arguments.omega_out):
        raise InvalidArgumentError("give either --theta-half and --theta-diff or --omega-in and --omega-out")
    if arguments.omega_in or arguments.omega_out:
        columns = {name: _given(arguments, name) for name in ("omega_in", "omega_out")}
    else:
        columns = {f"{name}_deg": _given(arguments, name) for name in ("theta_half", "theta_diff")}
        columns["phi_diff_deg"] = np.array(arguments.phi_diff or [90.0])
    length = max(len(array) for array in columns.values())
    if any(len(array) not in (1, length) for array in columns.values()):
        counts = ", ".join(f"{len(array)} {name}" for name, array in columns.items())
        raise InvalidArgumentError(f"{counts} cannot be combined: give equally many of each, or one")
    return {name: np.repeat(array, length // len(array), axis=0) for name, array in columns.items()}


def _given(arguments: argparse.Namespace, name: str) -> Array:
    values = getattr(arguments, name)
    if not values:
        raise InvalidArgumentError(f"--{name.replace('_', '-')} is missing: a point needs both")
    return np.array(values, dtype=np.float64)


def _direction(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise argparse.ArgumentTypeError(f"must be three numbers x,y,z, not {text!r}")
    return numbers
