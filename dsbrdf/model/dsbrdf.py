"""Define the Directional Statistics BRDF model: mixtures of lobes whose parameters vary with theta_diff.

    f_c = sum_k amplitude_ck(theta_diff) s_k(theta'_k) + delta_c(theta_diff) [theta_half < 1 degree]

is the value of channel c, where s_k is a lobe of height 1 (`dsbrdf.model.lobes`) with the shape kappa_k, gamma_k and
center_k, and theta'_k is the angle theta_half stretched by elongation_k. All channels have the same shapes, so that the
amplitude of a lobe is its colour. In the paper's model, each channel has its own shapes. The paper's lobe
exp(kappa cos(theta_half)**gamma) - 1 has the amplitude expm1(kappa) (Nishino 2009, eqs. 3 and 5). The term delta_c,
which is added where theta_half < 1 degree, is from section 6 of the paper.

The model is non-negative, has equal values for both orders of the directions, and is continuous except at
theta_half = 1 degree, where delta_c ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import CENTER_CUTOFF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.evaluation import Evaluator
from dsbrdf.model.lobes import FAMILIES, MAX_CENTER
from dsbrdf.model.reflectance import RenderableModel, check_angle
from dsbrdf.model.splines import n_control_values

TEXTS = ("interpolation", "lobe")
"""Attributes of a model that are strings; all other attributes are arrays."""
INTERPOLATIONS = ("linear", "spline")
"""Interpolations of parameters between knots, see `DSBRDF`."""
# Larger parameters are refused, because the formula of the model may overflow.
_MAX_PARAMETERS = {"amplitude": 1e300, "kappa": 700.0, "gamma": 1e100, "delta": 1e300}
_MAX_ELONGATION = 10.0


@dataclass(frozen=True, eq=False, repr=False)
class DSBRDF(RenderableModel):
    """Evaluate, sample and store a fitted model of an isotropic BRDF.

    Attributes
    ----------
    theta_diff : ndarray, shape (B,)
        Knots of the amplitudes, increasing, 0 to pi/2 [rad].
    amplitude : ndarray, shape (3, D, K)
        Height of each of K lobes in each channel (red, green, blue) [1/sr], not negative; K may be 0. With the
        interpolation "linear", D = B, and these are the heights at the knots; log1p(amplitude) is linear between knots.
        With "spline", D = B + 2, and the logarithms are control values of a cubic B-spline, so all must be positive.
    kappa, gamma, center : ndarray, shape (C, S, K)
        Scale, shape and center [rad] of each lobe, for all channels (C = 1) or for each channel (C = 3), at the S
        control values of the knots ``shape_theta_diff``. With "spline", the logarithms of kappa and gamma are splines,
        and so is center. A positive center makes a ring, a negative center a cusp at the normal.
    elongation : ndarray, shape (E, K)
        Stretch of each lobe, 0 for a round lobe, at the E control values of the knots ``elongation_theta_diff``.
    shape_theta_diff, elongation_theta_diff : ndarray
        Knots of shapes and of elongations [rad]; by default, the knots of the amplitudes, and a single knot.
    delta : ndarray, shape (3, B)
        Value added where theta_half < 1 degree [1/sr], linear between the knots, not negative; 0 by default.
    interpolation : {"linear", "spline"}
    lobe : {"hemi_epd", "student"}

    Raises
    ------
    InvalidArgumentError
        If shapes disagree, a number is not finite or a parameter is out of range.
    """

    theta_diff: Array
    amplitude: Array
    kappa: Array
    gamma: Array
    center: Array = None  # type: ignore[assignment]
    elongation: Array = None  # type: ignore[assignment]
    shape_theta_diff: Array = None  # type: ignore[assignment]
    elongation_theta_diff: Array = None  # type: ignore[assignment]
    delta: Array = None  # type: ignore[assignment]
    interpolation: str = "spline"
    lobe: str = "hemi_epd"

    def __post_init__(self) -> None:
        arrays = [field.name for field in fields(self) if field.name not in TEXTS]
        defaults: dict[str, Callable[[], Array]] = {
            "center": lambda: np.zeros_like(self.kappa),
            "elongation": lambda: np.zeros((1, self.kappa.shape[-1] if self.kappa.ndim else 0)),
            "shape_theta_diff": lambda: self.theta_diff,
            "elongation_theta_diff": lambda: np.zeros(1),
            "delta": lambda: np.zeros((3, self.theta_diff.size)),
        }
        for name in arrays:
            value: ArrayLike | None = getattr(self, name)
            try:
                array = np.array(defaults[name]() if value is None and name in defaults else value, dtype=float)
            except (TypeError, ValueError):
                raise InvalidArgumentError(f"{name} must be an array of numbers") from None
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if self.interpolation not in INTERPOLATIONS:
            known = ", ".join(INTERPOLATIONS)
            raise InvalidArgumentError(f"interpolation must be one of {known}, not {self.interpolation!r}")
        if self.lobe not in FAMILIES:
            raise InvalidArgumentError(f"lobe must be one of {', '.join(FAMILIES)}, not {self.lobe!r}")
        self._check_shapes()
        self._check_ranges()

    def _check_shapes(self) -> None:
        """Raise InvalidArgumentError unless the knots increase, the shapes agree and all numbers are finite."""
        for name in ("theta_diff", "shape_theta_diff", "elongation_theta_diff"):
            knots = getattr(self, name)
            if knots.ndim != 1 or knots.size == 0:
                raise InvalidArgumentError(f"{name} must be a sequence of at least one knot")
            if not (knots[0] >= 0 and knots[-1] <= np.pi / 2 + 1e-9 and np.all(np.diff(knots) > 0)):
                raise InvalidArgumentError(f"the knots {name} must increase from 0 or more to at most pi/2")
        if self.amplitude.ndim != 3 or self.kappa.ndim != 3:
            raise InvalidArgumentError("amplitude and kappa must have three axes: channel, control value and lobe")
        count = n_control_values if self.interpolation == "spline" else int
        of_lobes = 1 if len(self.kappa) == 1 else 3, count(self.shape_theta_diff.size), self.n_lobes
        shapes = {
            "amplitude": (3, count(self.theta_diff.size), self.n_lobes),
            **dict.fromkeys(("kappa", "gamma", "center"), of_lobes),
            "elongation": (count(self.elongation_theta_diff.size), self.n_lobes),
            "delta": (3, self.theta_diff.size),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape:
                raise InvalidArgumentError(f"{name} must have shape {shape}, not {array.shape}")
            if not np.isfinite(array).all():
                raise InvalidArgumentError(f"every {name} must be finite")

    def _check_ranges(self) -> None:
        """Raise InvalidArgumentError if a parameter is outside the domain of the formula."""
        if not np.all(self.kappa > 0):
            raise InvalidArgumentError("every kappa must be positive")
        for name in ("amplitude", "gamma", "delta"):
            lowest = getattr(self, name).min(initial=np.inf)
            if self.interpolation == "spline" and name != "delta" and lowest <= 0:
                raise InvalidArgumentError(
                    f'every {name} must be positive for the interpolation "spline", which needs its logarithm'
                )
            if lowest < 0:
                raise InvalidArgumentError(f"every {name} must be zero or positive")
        for name, largest in _MAX_PARAMETERS.items():
            if getattr(self, name).max(initial=0.0) > largest:
                raise InvalidArgumentError(f"every {name} must be at most {largest:g}: values of a larger one overflow")
        if np.abs(self.center).max(initial=0.0) > MAX_CENTER:
            raise InvalidArgumentError(f"every center must lie between -{MAX_CENTER:g} and {MAX_CENTER:g} radians")
        if np.abs(self.elongation).max(initial=0.0) > _MAX_ELONGATION:
            raise InvalidArgumentError(f"every elongation must be at most {_MAX_ELONGATION:g} in size")

    @property
    def n_lobes(self) -> int:
        """Number K of lobes."""
        return int(self.amplitude.shape[2])

    @property
    def n_numbers(self) -> int:
        """Number of stored parameters without knots; centers, elongations and deltas count unless all are 0."""
        rings = int(np.count_nonzero(self.is_ring))
        stored = self.amplitude.size + self.kappa.size + self.gamma.size + rings * self.center[..., 0:1].size
        return int(stored + sum(array.size for array in (self.elongation, self.delta) if array.any()))

    @property
    def is_ring(self) -> Mask:
        """Mask of lobes whose center is not 0 everywhere, shape (K,)."""
        return np.asarray(np.any(self.center != 0.0, axis=(0, 1)))

    def __repr__(self) -> str:
        knots = f"{self.theta_diff.size} knots" if self.theta_diff.size > 1 else "1 knot"
        lobes = f"{self.n_lobes} lobes" if self.n_lobes != 1 else "1 lobe"
        return f"<DSBRDF: {lobes} ({self.lobe}), {knots}, {self.n_numbers} numbers>"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))

    def __hash__(self) -> int:
        # Equal models must have equal hashes: adding 0 turns -0 into 0.
        return hash(tuple((v + 0.0).tobytes() if isinstance(v, np.ndarray) else v for v in self._state().values()))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(self._state().values())

    def _state(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,) that are not checked, also for directions below the horizon."""
        values = self._evaluator.values(theta_half, theta_diff, phi_diff)
        if self._has_delta:
            inside = theta_half < CENTER_CUTOFF
            values[inside] += self._delta_at(theta_diff[inside])
        return values

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_diff the values (3, H, P) [1/sr] at all pairs of theta_half (H,) and phi_diff (P,)."""
        delta = (self._delta_at(theta_diff)[..., None] * (theta_half < CENTER_CUTOFF)).astype(phi_diff.dtype)
        for added, values in zip(delta, self._evaluator.grid(theta_half, theta_diff, phi_diff), strict=True):
            yield values + added[..., None] if self._has_delta else values

    def parameters_at(self, theta_diff: ArrayLike) -> dict[str, Array]:
        """Return the interpolated parameters at angles theta_diff.

        Parameters
        ----------
        theta_diff : array_like, shape (...)
            Angles [rad].

        Returns
        -------
        dict
            ``amplitude`` (..., 3, K), ``kappa``, ``gamma`` and ``center`` (..., C, K), ``elongation`` (..., K),
            ``delta`` (..., 3).
        """
        theta_diff = check_angle("theta_diff", theta_diff)
        flat = theta_diff.ravel()
        parts = (*self._evaluator.parameters(flat), self._delta_at(flat))
        names = ("amplitude", "kappa", "gamma", "center", "elongation", "delta")
        return {name: part.reshape(theta_diff.shape + part.shape[1:]) for name, part in zip(names, parts, strict=True)}

    def select(self, lobes: tuple[int, ...], *, with_delta: bool) -> DSBRDF:
        """Return a model with only the lobes of some indices, and with or without `delta`."""
        names = ("amplitude", "kappa", "gamma", "center", "elongation")
        chosen = {name: getattr(self, name)[..., list(lobes)] for name in names}
        delta = self.delta if with_delta else np.zeros_like(self.delta)
        return DSBRDF(**(self._state() | chosen | {"delta": delta}))

    @property
    def kinks(self) -> Array:
        """Angles theta_diff (n,) [rad] at which the values of the model have a kink."""
        return self.theta_diff if self.interpolation == "linear" else np.zeros(0)

    def _delta_at(self, theta_diff: Array) -> Array:
        return np.stack([np.interp(theta_diff, self.theta_diff, row) for row in self.delta], axis=-1)

    @cached_property
    def _has_delta(self) -> bool:
        return bool(self.delta.any())

    @cached_property
    def _evaluator(self) -> Evaluator:
        spline, shape = self.interpolation == "spline", (self.kappa, self.gamma)
        amplitude = np.log(self.amplitude) if spline else np.log1p(self.amplitude)
        scaled = [np.log(part) if spline else part for part in shape]
        rows = [np.hstack([*part]) for part in (amplitude, *scaled, self.center)]
        return Evaluator(
            (self.theta_diff, rows[0]),
            (self.shape_theta_diff, np.concatenate(rows[1:], axis=1)),
            (self.elongation_theta_diff, self.elongation),
            n_shapes=self.kappa.shape[0],
            is_ring=self.is_ring,
            family=self.lobe,
            spline=spline,
        )
