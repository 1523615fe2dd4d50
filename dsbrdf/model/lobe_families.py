"""The families of lobes: how a lobe falls with its offset, the distance of theta' from its center.

A family has a name and a row in `FAMILIES`; `dsbrdf.model.lobes` has the formulas, and what they have in common.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from dsbrdf.arrays import Array

Family = Literal["hemi_epd", "student"]
"""Names of the families."""
LARGEST_CENTER = 1.57
"""A center is so far from the normal at most [rad]: at pi/2, the horizon, rounding decides the tangent's sign."""
LARGEST_TANGENT = float(np.tan(LARGEST_CENTER))
_STEEPEST_TANGENT = 1e12
_LOWEST_LOG = -200.0  # squares of exponentials below need subnormal numbers, which take a hundred times as long


class SeriesMath(NamedTuple):
    """Functions on numbers of another program."""

    exp: Callable[[Any], Any]
    expm1: Callable[[Any], Any]
    log1p: Callable[[Any], Any]


def tangent_of_offset(squared_tangent: Array, center: Array, largest: float = LARGEST_TANGENT) -> Array:
    """tan(theta' - center), as `dsbrdf.model.lobes` defines it."""
    root, tan_center = np.sqrt(squared_tangent), np.tan(center)
    tangent = (root - tan_center) / (1.0 + root * np.maximum(tan_center, 0.0))
    return np.clip(tangent, -largest, largest)


def _log_cos(squared_tangent: Array, center: Array | None) -> Array:
    """Logarithm of cos(theta' - center), exact where it is small."""
    at = squared_tangent if center is None else tangent_of_offset(squared_tangent, center, _STEEPEST_TANGENT) ** 2
    return -0.5 * np.log1p(at)


def _power(log_power: Array) -> Array:
    return np.exp(np.maximum(log_power, _LOWEST_LOG))


class LobeFamily(ABC):
    """What a family defines; kappa and gamma are positive, angles in radians.

    `glsl` are statements that return a lobe of height 1, of ``squared`` and ``top_squared``, the squared tangents of
    the offset and of the negative part of the center, and of ``kappa`` and ``gamma``.
    """

    glsl: str

    @abstractmethod
    def fall_to_half(self, kappa: Array) -> Array:
        """Gamma times the reach at half the height."""

    @abstractmethod
    def slope_of_fall(self, kappa: Array) -> Array:
        """Derivative of the logarithm of `fall_to_half` in log kappa."""

    @abstractmethod
    def reach(self, squared_tangent: Array) -> Array:
        """What gamma is multiplied by at an offset with a squared tangent."""

    @abstractmethod
    def squared_tangent(self, reach: Array) -> Array:
        """Inverse of `reach`."""

    @abstractmethod
    def slope_of_width(self, reach: Array, tangent: Array) -> Array:
        """Derivative of the offset in log reach, of a reach and the tangent there."""

    @abstractmethod
    def values(self, squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None) -> Array:
        """Lobes of height 1, of tan(theta')**2, kappa, gamma and the center, if there is one."""

    @abstractmethod
    def derivatives(
        self,
        squared_tangent: Array,
        kappa: Array,
        gamma: Array,
        center: Array | None,
        tangent: Array | None,
        negative: Array,
    ) -> tuple[Array, ...]:
        """Value and derivatives in log kappa, log gamma, the offset (else tan(theta')**2) and the negative center.

        The arguments are those of `values`, the tangent of the offset and the negative part of the center.
        """

    @abstractmethod
    def value_of_squares(self, math: SeriesMath, squared: Any, top_squared: Any, kappa: Any, gamma: Any) -> Any:
        """What `glsl` returns, on numbers of another program."""


class _HemiEpd(LobeFamily):
    glsl = """\
  float log_cos_top = -0.5 * dsbrdf_log1p(top_squared);
  float log_cos = -0.5 * dsbrdf_log1p(squared);
  float top = kappa * exp(gamma * log_cos_top);
  // expm1(top * ratio) / expm1(top), without overflow.
  float log_ratio = gamma * (log_cos - log_cos_top);
  return exp(top * dsbrdf_expm1(log_ratio)) * dsbrdf_expm1(-top * exp(log_ratio)) / dsbrdf_expm1(-top);
"""

    def fall_to_half(self, kappa: Array) -> Array:
        return np.log(kappa / np.log1p(0.5 * np.expm1(kappa)))

    def slope_of_fall(self, kappa: Array) -> Array:
        half = 0.5 * np.expm1(kappa)
        return (1.0 - kappa * (half + 0.5) / ((1.0 + half) * np.log1p(half))) / self.fall_to_half(kappa)

    def reach(self, squared_tangent: Array) -> Array:
        return 0.5 * np.log1p(squared_tangent)

    def squared_tangent(self, reach: Array) -> Array:
        return np.expm1(np.minimum(2.0 * reach, -_LOWEST_LOG))

    def slope_of_width(self, reach: Array, tangent: Array) -> Array:
        return reach / tangent

    def values(self, squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None) -> Array:
        log_cos = _log_cos(squared_tangent, center)
        if center is None:
            return np.expm1(kappa * _power(gamma * log_cos)) / np.expm1(kappa)
        log_cos_top = -0.5 * np.log1p(np.tan(np.minimum(center, 0.0)) ** 2)
        top = kappa * _power(gamma * log_cos_top)
        return np.expm1(top * _power(gamma * (log_cos - log_cos_top))) / np.expm1(top)

    def derivatives(
        self,
        squared_tangent: Array,
        kappa: Array,
        gamma: Array,
        center: Array | None,
        tangent: Array | None,
        negative: Array,
    ) -> tuple[Array, ...]:
        log_cos = _log_cos(squared_tangent, center)
        log_cos_top = -0.5 * np.log1p(np.tan(negative) ** 2)
        top = kappa * _power(gamma * log_cos_top)
        ratio = _power(gamma * (log_cos - log_cos_top))
        scale = 1.0 / np.expm1(top)
        exponent = top * ratio
        value = np.expm1(exponent) * scale
        by_log_ratio = exponent * np.exp(exponent) * scale
        by_log_top = by_log_ratio - value * (top * np.exp(top) * scale)
        by_log_gamma = by_log_ratio * gamma * (log_cos - log_cos_top) + by_log_top * gamma * log_cos_top
        slope = by_log_ratio * gamma
        # d log cos / d negative = -tan(negative), and the ratio is taken to the top.
        by_top = (by_log_top - by_log_ratio) * gamma * -np.tan(negative)
        by_offset = -0.5 * slope / (1.0 + squared_tangent) if tangent is None else -slope * tangent
        return value, by_log_top, by_log_gamma, by_offset, by_top

    def value_of_squares(self, math: SeriesMath, squared: Any, top_squared: Any, kappa: Any, gamma: Any) -> Any:
        log_cos, log_cos_top = -0.5 * math.log1p(squared), -0.5 * math.log1p(top_squared)
        top, log_ratio = kappa * math.exp(gamma * log_cos_top), gamma * (log_cos - log_cos_top)
        # expm1(top * ratio) / expm1(top), without overflow.
        return math.exp(top * math.expm1(log_ratio)) * math.expm1(-top * math.exp(log_ratio)) / math.expm1(-top)


class _Student(LobeFamily):
    glsl = """\
  return exp(-kappa * (dsbrdf_log1p(gamma * squared) - dsbrdf_log1p(gamma * top_squared)));
"""

    def fall_to_half(self, kappa: Array) -> Array:
        return np.expm1(np.log(2.0) / kappa)

    def slope_of_fall(self, kappa: Array) -> Array:
        power = np.log(2.0) / kappa
        return -power / -np.expm1(-power)

    def reach(self, squared_tangent: Array) -> Array:
        return squared_tangent

    def squared_tangent(self, reach: Array) -> Array:
        return reach

    def slope_of_width(self, reach: Array, tangent: Array) -> Array:  # noqa: ARG002 (the reach is the tangent's square)
        return 0.5 * tangent / (1.0 + tangent**2)

    def values(self, squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None) -> Array:
        at = squared_tangent if center is None else tangent_of_offset(squared_tangent, center) ** 2
        top = 0.0 if center is None else np.log1p(gamma * np.tan(np.minimum(center, 0.0)) ** 2)
        return np.exp(np.maximum(-kappa * (np.log1p(gamma * at) - top), _LOWEST_LOG))

    def derivatives(
        self,
        squared_tangent: Array,
        kappa: Array,
        gamma: Array,
        center: Array | None,  # noqa: ARG002 (its tangents are enough)
        tangent: Array | None,
        negative: Array,
    ) -> tuple[Array, ...]:
        square = squared_tangent if tangent is None else tangent**2
        tangent_top = np.tan(negative)
        at, top = gamma * square, gamma * tangent_top**2
        fall = np.maximum(-kappa * (np.log1p(at) - np.log1p(top)), _LOWEST_LOG)
        value = np.exp(fall)
        by_log_gamma = -value * kappa * (at / (1.0 + at) - top / (1.0 + top))
        by_square = -value * kappa * gamma / (1.0 + at)
        by_top = value * kappa * gamma / (1.0 + top) * 2.0 * tangent_top * (1.0 + tangent_top**2)
        by_offset = by_square if tangent is None else by_square * 2.0 * tangent * (1.0 + square)
        return value, value * fall, by_log_gamma, by_offset, by_top

    def value_of_squares(self, math: SeriesMath, squared: Any, top_squared: Any, kappa: Any, gamma: Any) -> Any:
        return math.exp(-kappa * (math.log1p(gamma * squared) - math.log1p(gamma * top_squared)))


FAMILIES: dict[str, LobeFamily] = {"hemi_epd": _HemiEpd(), "student": _Student()}
"""Known lobes, by name; a new family is a class, a name in `Family` and a row here."""
