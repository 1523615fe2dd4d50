"""Define the common interface of isotropic, reciprocal models, blends, functions as models, and a check of energy.

In a furnace with uniformly bright walls, a surface with the directional albedo rho has rho times the brightness of the
walls. A surface that conserves energy is never brighter than the walls. A reciprocal BRDF has equal values for swapped
directions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import (
    PHI_DIFF,
    QUARTER,
    THETA_DIFF,
    THETA_HALF,
    check_directions,
    checked_angles,
    directions,
    half_difference,
    incident_cosines,
    random_directions,
)
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.sampling import ANGLES, DirectionSampler, Samples, direction_sampler

# A direction whose cosine to the normal is smaller is below the horizon; the bound is not 0 because of rounding.
_MIN_COSINE_ABOVE_HORIZON = -1e-12


class ReflectanceModel(ABC):
    """Evaluate RGB values at angles and directions; a subclass defines `evaluate_unmasked`."""

    @abstractmethod
    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,) that are not checked, also for directions below the horizon."""

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_diff the values (3, H, P) [1/sr] at all pairs of theta_half (H,) and phi_diff (P,)."""
        for diff in theta_diff.tolist():
            angles = np.meshgrid(theta_half, diff, phi_diff, indexing="ij")
            values = self.evaluate_unmasked(*(one.ravel() for one in angles))
            yield values.T.reshape(3, theta_half.size, phi_diff.size)

    def evaluate(self, theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike = np.pi / 2) -> Array:
        """Return RGB values (..., 3) [1/sr] at half and difference angles (...) that broadcast.

        Parameters
        ----------
        theta_half, theta_diff : array_like
            Angles, 0 to pi/2 [rad].
        phi_diff : array_like, optional
            Azimuth of omega_in about the half vector [rad]; at pi/2, the default, both directions have equal angles to
            the normal. If a direction is below the horizon, the value is 0.

        Raises
        ------
        InvalidArgumentError
            If an angle is not a number or out of range, or the shapes do not broadcast.
        """
        theta_half, theta_diff = check_angle("theta_half", theta_half), check_angle("theta_diff", theta_diff)
        phi_diff = np.asarray(phi_diff, dtype=float)
        if not np.isfinite(phi_diff).all():
            raise InvalidArgumentError("phi_diff must be finite")
        # Broadcasting takes as long as the evaluation of a point, so it is skipped if all shapes are equal.
        if not theta_half.shape == theta_diff.shape == phi_diff.shape:
            checked = checked_angles(theta_half=theta_half, theta_diff=theta_diff, phi_diff=phi_diff)
            theta_half, theta_diff, phi_diff = np.broadcast_arrays(*checked)
        flat = theta_half.ravel(), theta_diff.ravel(), phi_diff.ravel()
        values = self.evaluate_unmasked(*flat)
        if (flat[0] + flat[1] > np.pi / 2).any():  # At smaller angles, both directions are above the horizon.
            values[np.minimum(*incident_cosines(*flat)) < _MIN_COSINE_ABOVE_HORIZON] = 0.0
        return values.reshape(*theta_half.shape, 3)

    def evaluate_directions(self, omega_in: ArrayLike, omega_out: ArrayLike) -> Array:
        """Return RGB values (..., 3) [1/sr] for pairs of unit vectors (..., 3) that broadcast, with normal (0, 0, 1).

        If a direction is below the horizon (z < 0), the value is 0. Raises InvalidArgumentError if a direction is not
        a unit vector.
        """
        first = check_directions("omega_in", omega_in, below_horizon=True)
        second = check_directions("omega_out", omega_out, below_horizon=True)
        below = np.minimum(first[..., 2], second[..., 2]) < 0.0
        theta_half, theta_diff, phi_diff = half_difference(first, second)
        flat = (np.minimum(theta_half, np.pi / 2).ravel(), theta_diff.ravel(), phi_diff.ravel())
        values = self.evaluate_unmasked(*flat).reshape(*below.shape, 3)
        values[below] = 0.0
        return values

    def tabulate(self) -> Array:
        """Return values at the nodes of the measurement grid, shape (3, 90, 90, 180) [1/sr].

        Where a direction is below the horizon, nodes have values of the formula too, so that programs can interpolate
        near the horizon.
        """
        grid = np.empty((3, THETA_HALF.size, THETA_DIFF.size, PHI_DIFF.size))
        for row, values in enumerate(self.evaluate_grid(THETA_HALF, THETA_DIFF, PHI_DIFF[:QUARTER])):
            grid[:, :, row, :QUARTER] = values
            grid[:, :, row, QUARTER:] = values[:, :, -2:0:-1]
        return grid


class RenderableModel(ReflectanceModel):
    """Add the directional albedo and importance sampling to a model of a whole material."""

    @property
    def kinks(self) -> Array:
        """Angles theta_diff (n,) [rad] at which the values of the model have a kink."""
        return np.zeros(0)

    def albedo(self, theta_out: ArrayLike) -> Array:
        """Return the directional albedo, the fraction of light from a direction that is reflected, by quadrature.

        Parameters
        ----------
        theta_out : array_like, shape (...)
            Angle of the direction to the normal, 0 to pi/2 [rad].

        Returns
        -------
        ndarray, shape (..., 3)
            ``integral f cos(theta_in) d omega_in``; at most 1 if the model conserves energy.
        """
        return directional_albedo(self.evaluate_unmasked, check_angle("theta_out", theta_out), self.kinks)

    def sample(self, omega_out: ArrayLike, rng: np.random.Generator) -> Samples:
        """Draw a direction omega_in for each omega_out, roughly in proportion to ``f cos(theta_in)``.

        Parameters
        ----------
        omega_out : array_like, shape (..., 3)
            Unit vectors above the horizon; ``np.broadcast_to(omega_out, (n, 3))`` draws n times for one direction.
        rng : numpy.random.Generator

        Returns
        -------
        Samples
            Directions, their probability densities and their weights; see `dsbrdf.model.sampling`.

        Raises
        ------
        InvalidArgumentError
            If a direction is not a unit vector above the horizon.
        """
        towards = check_directions("omega_out", omega_out)
        flat = towards.reshape(-1, 3)
        omega_in = self.sampler.sample(flat, rng)
        pdf = self.sampler.pdf(omega_in, flat)
        cosine = omega_in[:, 2] / np.where(pdf > 0.0, pdf, np.inf)
        weight = self.evaluate_directions(omega_in, flat) * cosine[:, None]
        return Samples(omega_in.reshape(towards.shape), pdf.reshape(towards.shape[:-1]), weight.reshape(towards.shape))

    def pdf(self, omega_in: ArrayLike, omega_out: ArrayLike) -> Array:
        """Return the probability density of omega_in in `sample`, for omega_out.

        Parameters
        ----------
        omega_in, omega_out : array_like, shape (..., 3)
            Unit vectors that broadcast; the normal is (0, 0, 1).

        Returns
        -------
        ndarray, shape (...)
            Density per solid angle [1/sr]; 0 if a direction is below the horizon. Its integral is the fraction of
            samples above the horizon.

        Raises
        ------
        InvalidArgumentError
            If a direction is not a unit vector.
        """
        first = check_directions("omega_in", omega_in, below_horizon=True)
        first, second = np.broadcast_arrays(first, check_directions("omega_out", omega_out, below_horizon=True))
        return self.sampler.pdf(first.reshape(-1, 3), second.reshape(-1, 3)).reshape(first.shape[:-1])

    @cached_property
    def sampler(self) -> DirectionSampler:
        """The mixtures of densities that `sample` draws from; exports copy the numbers of these mixtures."""
        return direction_sampler(self.evaluate_unmasked)


def check_angle(name: str, angle: ArrayLike) -> Array:
    """Return angles as an array; raise InvalidArgumentError if an angle is not between 0 and pi/2."""
    angle = np.asarray(angle, dtype=float)
    slack = 1e-6  # Conversion to radians or to single precision may round 90 degrees up.
    if not ((angle >= 0.0) & (angle <= np.pi / 2 + slack)).all():
        raise InvalidArgumentError(f"{name} must lie between 0 and 90 degrees (0 and pi/2 radians)")
    return np.minimum(angle, np.pi / 2)


@dataclass(frozen=True)
class Blend(RenderableModel):
    """Evaluate the geometric mean ``first**(1 - t) second**t`` of two models."""

    first: RenderableModel
    second: RenderableModel
    t: float

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,) that are not checked, also for directions below the horizon."""
        angles = theta_half, theta_diff, phi_diff
        return self._mean(self.first.evaluate_unmasked(*angles), self.second.evaluate_unmasked(*angles))

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_diff the values (3, H, P) [1/sr] at all pairs of theta_half (H,) and phi_diff (P,)."""
        axes = theta_half, theta_diff, phi_diff
        return map(self._mean, self.first.evaluate_grid(*axes), self.second.evaluate_grid(*axes))

    @property
    def kinks(self) -> Array:
        """Angles theta_diff (n,) [rad] at which the values of the model have a kink."""
        return np.union1d(self.first.kinks, self.second.kinks)

    def _mean(self, first: Array, second: Array) -> Array:
        return np.asarray(first ** (1.0 - self.t) * second**self.t)


def blend(a: RenderableModel, b: RenderableModel, t: float) -> Blend:
    """Return a model whose values lie between the values of two models.

    Values are geometric means ``a**(1 - t) b**t``. A blend of a polished and a rough surface has one highlight of
    medium width; an arithmetic mean would have two highlights. Blends of positive, reciprocal models are positive and
    reciprocal. The albedo of a blend is at most the arithmetic mean of both albedos, so that a blend conserves energy
    if both models conserve energy.

    Parameters
    ----------
    a, b : DSBRDF, LayeredModel or Blend
    t : float
        Position of the blend, from 0 (`a`) to 1 (`b`).

    Raises
    ------
    InvalidArgumentError
        If t is out of range, or `a` or `b` is not a model.
    """
    for end in (a, b):
        if not isinstance(end, RenderableModel):
            raise InvalidArgumentError(f"only models, such as result.model, can be blended, not a {type(end).__name__}")
    if not 0.0 <= t <= 1.0:
        raise InvalidArgumentError(f"t must lie between 0 and 1, not at {t:g}")
    return Blend(a, b, float(t))


@dataclass(frozen=True, eq=False)
class FunctionModel(RenderableModel):
    """Evaluate a function of directions as a model, for example a neural encoding or a formula of one's own.

    Attributes
    ----------
    function : callable
        Takes omega_in and omega_out, unit vectors (n, 3) above the horizon, and returns values (n, 3) or (n, 1) [1/sr].
        The values of the model are means of both orders of the directions, because models here are reciprocal.
    """

    function: Callable[[Array, Array], ArrayLike]

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,) that are not checked; 0 for directions below the horizon."""
        first, second = directions(theta_half, theta_diff, phi_diff)
        above = np.minimum(first[:, 2], second[:, 2]) > 0.0
        values = np.zeros((above.size, 3))
        values[above] = 0.5 * (self._values(first[above], second[above]) + self._values(second[above], first[above]))
        return values

    def _values(self, first: Array, second: Array) -> Array:
        values = np.asarray(self.function(first, second), dtype=float)
        if values.shape not in ((len(first), 3), (len(first), 1)) or not np.isfinite(values).all():
            raise InvalidArgumentError(
                f"the function must return finite values of the shape ({len(first)}, 3) for as many pairs of "
                f"directions, not of the shape {values.shape}"
            )
        return values


_FURNACE_THETA_OUT = ANGLES[:-1:2]  # angles to the normal from 0 to 87 degrees [rad]
_N_SWAPPED_PAIRS = 4096


@dataclass(frozen=True, eq=False)
class FurnaceReport:
    """Report the energy and the reciprocity of a model.

    Attributes
    ----------
    theta_out : ndarray, shape (n,)
        Angles to the normal [rad].
    albedo : ndarray, shape (n, 3)
        Brightness in the furnace, relative to the walls, in each channel.
    reciprocity_error : float
        Largest difference between values of swapped directions, relative to the larger value.
    """

    theta_out: Array
    albedo: Array
    reciprocity_error: float

    @property
    def largest_albedo(self) -> float:
        """Largest albedo over angles and channels; at most 1 if the model conserves energy."""
        return float(self.albedo.max())

    @property
    def conserves_energy(self) -> bool:
        """Whether the albedo is at most 1, but for the error of the quadrature, at all angles and in all channels."""
        return self.largest_albedo <= 1.0 + 1e-5

    def __str__(self) -> str:
        angle = np.degrees(self.theta_out[self.albedo.max(axis=1).argmax()])
        verdict = "no direction returns" if self.conserves_energy else "some directions return"
        return (
            f"White furnace: {verdict} more than is received; the largest albedo is {self.largest_albedo:.3f}, at "
            f"{angle:.0f} degrees. Reciprocity: values of swapped directions differ by {self.reciprocity_error:.1e}."
        )


def white_furnace(model: RenderableModel) -> FurnaceReport:
    """Check the energy and the reciprocity of a model."""
    rng = np.random.default_rng(0)
    first, second = random_directions(rng, rng.random((2, _N_SWAPPED_PAIRS)))
    values, swapped = model.evaluate_directions(first, second), model.evaluate_directions(second, first)
    scale = np.maximum(np.maximum(values, swapped), np.finfo(float).tiny)
    error = float(np.max(np.abs(values - swapped) / scale))
    return FurnaceReport(_FURNACE_THETA_OUT, model.albedo(_FURNACE_THETA_OUT), error)
