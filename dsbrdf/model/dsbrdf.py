"""The Directional Statistics BRDF model: mixtures of hemi-EPDs whose parameters vary with theta_diff.

    f(theta_half, theta_diff) = sum_k [exp(kappa_k cos(theta_half - center_k)**gamma_k) - 1]
                                + delta [theta_half < 1 degree]

for each colour channel, where kappa, gamma, center and delta are interpolated in theta_diff between knots and
held beyond the first and the last (Nishino 2009, eq. 5 and section 6).  delta runs linearly; the others either do
too (the paper), or log kappa, log gamma and center follow a natural cubic spline, which needs fewer knots.  Where no
data held the spline, in a gap between knots, it is kept near the values at the knots.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.data.geometry import check_directions, half_difference
from dsbrdf.data.grid import CENTER_CUTOFF, GRID_SHAPE, THETA_DIFF, THETA_HALF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.evaluation import Mixture, linear
from dsbrdf.model.hemi_epd import half_width

Array = NDArray[np.float64]

INTERPOLATIONS = ("linear", "cubic")
"""How parameters run between knots: linear in kappa and gamma, or a cubic spline in their logarithms."""


# Beyond any reflectance, and far enough from the largest float64 for the sum of all lobes and between knots.
_LARGEST = {
    "linear": {"kappa": 700.0, "gamma": 1e100, "delta": 1e300},
    "cubic": {"kappa": 350.0, "gamma": 1e100, "delta": 1e300},  # a spline may go to twice the values at its knots
}


@dataclass(frozen=True, eq=False)
class DSBRDF:
    """A fitted model of an isotropic BRDF.

    Attributes
    ----------
    theta_diff : ndarray, shape (D,)
        Knots, increasing, 0 to pi/2 [rad].
    kappa, gamma, center : ndarray, shape (3, D, K)
        Scale, shape and ring angle [rad] of each lobe, per channel (red, green, blue) and knot.  K may be 0.
    delta : ndarray, shape (3, D)
        Height added where theta_half < 1 degree [1/sr].
    interpolation : str
        One of `INTERPOLATIONS`.

    Raises
    ------
    InvalidArgumentError
        If shapes disagree, a number is not finite or a parameter is out of range.
    """

    theta_diff: Array
    kappa: Array
    gamma: Array
    center: Array
    delta: Array
    interpolation: str = "linear"

    def __post_init__(self) -> None:
        for name in ("theta_diff", "kappa", "gamma", "center", "delta"):
            array = np.array(getattr(self, name), dtype=float)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        _check_model(self)

    @property
    def n_lobes(self) -> int:
        """Number K of lobes in each channel."""
        return int(self.kappa.shape[2])

    def evaluate(self, theta_half: ArrayLike, theta_diff: ArrayLike) -> Array:
        """BRDF values for half and difference angles.

        Parameters
        ----------
        theta_half, theta_diff : array_like
            Angles, 0 to pi/2 [rad]; they broadcast together.

        Returns
        -------
        ndarray, shape (..., 3)
            RGB values [1/sr].

        Raises
        ------
        InvalidArgumentError
            If an angle is not a number or out of range, or the shapes do not broadcast.
        """
        theta_half, theta_diff = _check_angle("theta_half", theta_half), _check_angle("theta_diff", theta_diff)
        try:
            if theta_half.shape != theta_diff.shape:  # a check that costs as much as a point
                theta_half, theta_diff = np.broadcast_arrays(theta_half, theta_diff)
        except ValueError:
            shapes = f"{theta_half.shape} and {theta_diff.shape}"
            raise InvalidArgumentError(
                f"theta_half and theta_diff must broadcast together, not have {shapes}"
            ) from None
        flat_half, flat_diff = theta_half.ravel(), theta_diff.ravel()
        values = self._mixture.values(flat_half, flat_diff)
        inside = flat_half < CENTER_CUTOFF
        if inside.any():
            values[inside] += linear(self.theta_diff, self.delta.T, flat_diff[inside])
        return values.reshape(*theta_half.shape, 3)

    def evaluate_directions(self, omega_in: ArrayLike, omega_out: ArrayLike) -> Array:
        """BRDF values for pairs of directions.

        Parameters
        ----------
        omega_in, omega_out : array_like, shape (..., 3)
            Unit vectors on the upper hemisphere, the normal being (0, 0, 1); they broadcast together.

        Returns
        -------
        ndarray, shape (..., 3)
            RGB values [1/sr].

        Raises
        ------
        InvalidArgumentError
            If a direction is not a unit vector or lies below the horizon.
        """
        theta_half, theta_diff, _ = half_difference(
            check_directions("omega_in", omega_in), check_directions("omega_out", omega_out)
        )
        return self.evaluate(theta_half, theta_diff)

    def tabulate(self) -> Array:
        """Values at the nodes of the measurement grid, shape (3, 90, 90, 180) [1/sr].

        Nodes below the horizon get the model's value too, so that programs that interpolate in the table meet
        no marker there.
        """
        grid = self.evaluate(THETA_HALF[:, None], THETA_DIFF)
        return np.repeat(np.moveaxis(grid, -1, 0)[..., None], GRID_SHAPE[2], axis=-1)

    def parameters_at(self, theta_diff: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Interpolated parameters.

        Parameters
        ----------
        theta_diff : array_like, shape (...)
            Angles [rad].

        Returns
        -------
        kappa, gamma, center : ndarray, shape (..., 3, K)
        delta : ndarray, shape (..., 3)
        """
        theta_diff = _check_angle("theta_diff", theta_diff)
        flat, shape = theta_diff.ravel(), theta_diff.shape
        kappa, gamma, center = (p.reshape(*shape, 3, self.n_lobes) for p in self._mixture.parameters(flat))
        return kappa, gamma, center, linear(self.theta_diff, self.delta.T, flat).reshape(*shape, 3)

    def select(self, lobes: tuple[int, ...], *, with_delta: bool) -> "DSBRDF":
        """Return the part of the model made of some of its lobes, with or without the delta term."""
        index = list(lobes)
        return DSBRDF(
            self.theta_diff,
            self.kappa[:, :, index],
            self.gamma[:, :, index],
            self.center[:, :, index],
            self.delta if with_delta else np.zeros_like(self.delta),
            self.interpolation,
        )

    def directional_albedo(self, theta_out: ArrayLike) -> Array:
        """Share of the light from each direction that is reflected, by quadrature.

        Parameters
        ----------
        theta_out : array_like, shape (...)
            Angle of the direction to the normal, 0 to pi/2 [rad].

        Returns
        -------
        ndarray, shape (..., 3)
            ``integral f cos(theta_in) d omega_in``; at most 1 where the model conserves energy.
        """
        widths = half_width(self.kappa, self.gamma)[self.center > 0.0]
        narrowest = float(widths.min(initial=np.pi / 2))
        return directional_albedo(self.evaluate, _check_angle("theta_out", theta_out), self.theta_diff, narrowest)

    @cached_property
    def _mixture(self) -> Mixture:
        return Mixture(self.theta_diff, self.kappa, self.gamma, self.center, cubic=self.interpolation == "cubic")


def _check_angle(name: str, angle: ArrayLike) -> Array:
    angle = np.asarray(angle, dtype=float)
    slack = 1e-9  # degrees converted to radians may round to just above pi/2
    if not ((angle >= 0.0) & (angle <= np.pi / 2 + slack)).all():
        raise InvalidArgumentError(f"{name} must lie between 0 and 90 degrees (0 and pi/2 radians)")
    return np.minimum(angle, np.pi / 2)


def _check_model(model: DSBRDF) -> None:
    knots, kappa = model.theta_diff, model.kappa
    if knots.ndim != 1 or knots.size == 0:
        raise InvalidArgumentError("theta_diff must be a sequence of at least one knot")
    if not (knots[0] >= 0 and knots[-1] <= np.pi / 2 + 1e-9 and np.all(np.diff(knots) > 0)):
        raise InvalidArgumentError("the knots theta_diff must increase from 0 or more to at most pi/2")
    if kappa.ndim != 3 or kappa.shape[:2] != (3, knots.size):
        raise InvalidArgumentError(f"kappa must have shape (3, {knots.size}, lobes), not {kappa.shape}")
    for name in ("gamma", "center"):
        if getattr(model, name).shape != kappa.shape:
            raise InvalidArgumentError(f"{name} must have the shape of kappa, {kappa.shape}")
    if model.delta.shape != (3, knots.size):
        raise InvalidArgumentError(f"delta must have shape (3, {knots.size}), not {model.delta.shape}")
    if not (np.all((kappa > 0) & (kappa < np.inf)) and np.all((model.gamma >= 0) & (model.gamma < np.inf))):
        raise InvalidArgumentError("every kappa must be positive, every gamma zero or positive, and both finite")
    if not (np.all((model.center >= 0) & (model.center <= np.pi / 2)) and np.all(np.isfinite(model.delta))):
        raise InvalidArgumentError("every center must lie between 0 and pi/2, and every delta must be finite")
    if model.interpolation == "cubic" and not np.all(model.gamma > 0):
        raise InvalidArgumentError(
            "every gamma must be positive for cubic interpolation, which is one of its logarithm"
        )
    if model.interpolation not in INTERPOLATIONS:
        known = ", ".join(INTERPOLATIONS)
        raise InvalidArgumentError(f"interpolation must be one of {known}, not {model.interpolation!r}")
    for name, largest in _LARGEST[model.interpolation].items():
        if getattr(model, name).max(initial=-np.inf) > largest or getattr(model, name).min(initial=np.inf) < -largest:
            raise InvalidArgumentError(f"no {name} may exceed {largest:g}: values would leave the range of numbers")
