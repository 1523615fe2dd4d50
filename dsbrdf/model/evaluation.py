"""Values of a mixture of lobes: at one point in microseconds, at a million without large arrays.

Between two knots every parameter is a polynomial in theta_diff, whose coefficients are found once for a model. A few
points look their coefficients up one by one. Many points are sorted, a block at a time, by the piece between knots that
they lie in; there each coefficient is a single number, and the lobes are taken one after the other, so that what is
computed stays in the cache. Both ways carry out the same operations on every point.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dsbrdf.model.splines import CENTER_OVERSHOOT, OVERSHOOT, parameter_spline

Array = NDArray[np.float64]

_FEW = 1024  # points that are quicker looked up than sorted
_BLOCK = 131072  # points sorted at a time; the pieces should not be shorter than NumPy's buffer of 8192
_LOWEST_EXPONENT = -690.0  # exponentials below need subnormal numbers, which take a hundred times as long
_FAINTEST = 1e-295  # values below, which such exponentials add up to, are 0
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class _Lobes:
    """Some lobes in the form that they are evaluated in, ring lobes last.

    Attributes
    ----------
    terms : ndarray, shape (T, R, D - 1)
        Coefficients of the parameters on each piece between knots. The R parameters are kappa, then gamma, of each
        lobe and channel, then center of each ring lobe and channel.
    bounds : tuple of two ndarray, shape (R, 1), or None
        Range that the parameters are kept to.
    n_lobes, n_rings : int
        Number of lobes, and of ring lobes among them.
    """

    terms: Array
    bounds: tuple[Array, Array] | None
    n_lobes: int
    n_rings: int

    def parameters(self, powers: Sequence[Array], terms: Array) -> Array:
        """Values (R, n) of the polynomials with these terms, (T, R, n) or (T, R, 1), at powers (n,) of the step."""
        result = terms[0] * powers[0]
        if len(terms) > len(powers):
            result += terms[-1]
        product = np.empty_like(result)
        for term, power in zip(terms[1:], powers[1:], strict=False):
            result += np.multiply(term, power, out=product)
        if self.bounds is not None:
            np.maximum(result, self.bounds[0], out=result)
            np.minimum(result, self.bounds[1], out=result)
        return result

    def single(self, lobe: int) -> "_Lobes":
        """Return one of the lobes."""
        is_ring = lobe >= self.n_lobes - self.n_rings
        kinds = [lobe, self.n_lobes + lobe] + is_ring * [self.n_lobes + self.n_rings + lobe]
        rows = (3 * np.array(kinds)[:, None] + np.arange(3)).ravel()
        bounds = None if self.bounds is None else (self.bounds[0][rows], self.bounds[1][rows])
        return _Lobes(np.ascontiguousarray(self.terms[:, rows]), bounds, 1, int(is_ring))


class Mixture:
    """The lobes of a model, made ready to be evaluated; safe to use from several threads.

    Parameters
    ----------
    theta_diff : ndarray, shape (D,)
        Knots [rad].
    kappa, gamma, center : ndarray, shape (3, D, K)
        Parameters at the knots.
    cubic : bool
        Whether log kappa, log gamma and center follow a spline, or kappa, gamma and center are linear.
    """

    def __init__(self, theta_diff: Array, kappa: Array, gamma: Array, center: Array, *, cubic: bool) -> None:
        self._knots = theta_diff
        self._cubic = cubic
        is_ring = np.any(center > 0, axis=(0, 1))
        self._order = np.argsort(is_ring, kind="stable")
        kinds = [kappa[:, :, self._order], gamma[:, :, self._order], center[:, :, is_ring]]
        if cubic:
            kinds[:2] = np.log(kinds[0]), np.log(kinds[1])
        rows = np.concatenate([kind.transpose(1, 2, 0).reshape(theta_diff.size, -1) for kind in kinds], axis=1)
        n_lobes, n_rings = kappa.shape[2], int(np.count_nonzero(is_ring))
        terms, bounds = _cubic_pieces(theta_diff, rows, 6 * n_lobes) if cubic else (_linear_pieces(rows), None)
        self._all = _Lobes(np.ascontiguousarray(terms.transpose(0, 2, 1)), bounds, n_lobes, n_rings)

    @cached_property
    def _each(self) -> tuple[_Lobes, ...]:
        return tuple(self._all.single(lobe) for lobe in range(self._all.n_lobes))

    def values(self, theta_half: Array, theta_diff: Array) -> Array:
        """Return the sum of the lobes, shape (n, 3), at angles (n,) from 0 to pi/2."""
        if self._all.n_lobes == 0:
            return np.zeros((theta_half.size, 3))
        if theta_half.size <= _FEW:
            pieces, powers = self._place(theta_diff)
            terms = self._all.terms.take(pieces, axis=2)
            total = self._sum(self._all, terms, powers, theta_half, _log_cosine(theta_half))
            return np.ascontiguousarray(_without_faintest(total).T)
        result = np.empty((theta_half.size, 3))
        for start in range(0, theta_half.size, _BLOCK):
            block = slice(start, start + _BLOCK)
            self._fill(result[block], theta_half[block], theta_diff[block])
        return result

    def parameters(self, theta_diff: Array) -> tuple[Array, Array, Array]:
        """Return kappa, gamma and center, shape (n, 3, K) each, at angles (n,)."""
        pieces, powers = self._place(theta_diff)
        rows = self._all.parameters(powers, self._all.terms.take(pieces, axis=2))
        k = self._all.n_lobes
        given = rows.reshape(-1, 3, theta_diff.size).transpose(2, 1, 0)
        parameters = np.zeros((3, theta_diff.size, 3, k))
        parameters[0][..., self._order] = given[..., :k]
        parameters[1][..., self._order] = given[..., k : 2 * k]
        parameters[2][..., self._order[k - self._all.n_rings :]] = given[..., 2 * k :]
        if self._cubic:
            np.exp(parameters[:2], out=parameters[:2])
        return parameters[0], parameters[1], parameters[2]

    def _place(self, theta_diff: Array) -> tuple[NDArray[np.intp], tuple[Array, ...]]:
        """Piece between knots of each angle, and the powers that the terms belong to."""
        pieces, step = _place(self._knots, theta_diff)
        if self._cubic:
            square = step * step
            return pieces, (step, square, square * step)
        share = _share(self._knots, pieces, step)
        return pieces, (1.0 - share, share)

    def _fill(self, result: Array, theta_half: Array, theta_diff: Array) -> None:
        """Write the values of one block, lobe by lobe on the points of each piece."""
        pieces, powers = self._place(theta_diff)
        order = np.argsort(
            pieces.astype(np.min_scalar_type(self._knots.size)), kind="stable"
        )  # radix, as they are short
        ends = np.cumsum(np.bincount(pieces))
        log_cosine = _log_cosine(theta_half)
        start = 0
        for piece, end in enumerate(ends.tolist()):
            chosen = order[start:end]
            start = end
            if chosen.size == 0:
                continue
            here = [power[chosen] for power in powers]
            half, about_normal = theta_half[chosen], log_cosine[chosen]
            total = np.zeros((3, chosen.size))
            for lobe in self._each:
                total += self._sum(lobe, lobe.terms[:, :, piece : piece + 1], here, half, about_normal)
            result[chosen] = _without_faintest(total).T

    def _sum(
        self, lobes: _Lobes, terms: Array, powers: Sequence[Array], theta_half: Array, about_normal: Array
    ) -> Array:
        """Sum (3, n) of lobes; written with logarithms, which costs two exponentials a lobe instead of a power."""
        rows = 3 * lobes.n_lobes
        first_ring = rows - 3 * lobes.n_rings
        parameters = lobes.parameters(powers, terms)
        kappa, exponent, center = parameters[:rows], parameters[rows : 2 * rows], parameters[2 * rows :]
        if self._cubic:
            np.exp(exponent, out=exponent)
        exponent[:first_ring] *= about_normal
        if lobes.n_rings:
            exponent[first_ring:] *= _log_cosine(theta_half - center)
        if self._cubic:
            exponent += kappa
        np.maximum(exponent, _LOWEST_EXPONENT, out=exponent)
        np.exp(exponent, out=exponent)
        if not self._cubic:
            exponent *= kappa
        np.expm1(exponent, out=exponent)
        return exponent.reshape(lobes.n_lobes, 3, -1).sum(axis=0)


def linear(knots: Array, values: Array, theta_diff: Array) -> Array:
    """Linear interpolation between knots, held at both ends.

    Parameters
    ----------
    knots : ndarray, shape (D,)
    values : ndarray, shape (D, C)
    theta_diff : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, C)
    """
    pieces, step = _place(knots, theta_diff)
    if knots.size == 1:
        return values[pieces]
    share = _share(knots, pieces, step)[:, None]
    return values[pieces] * (1.0 - share) + values[pieces + 1] * share


def _place(knots: Array, theta_diff: Array) -> tuple[NDArray[np.intp], Array]:
    """Piece between knots of each angle, and the step from its lower knot; held at both ends."""
    held = np.minimum(np.maximum(theta_diff, knots[0]), knots[-1])
    pieces = knots[1:-1].searchsorted(held, side="right")
    return pieces, held - knots[pieces]


def _share(knots: Array, pieces: NDArray[np.intp], step: Array) -> Array:
    """Share of the way through a piece, 0 to 1; 0 if there is a single knot."""
    return step / (knots[pieces + 1] - knots[pieces]) if knots.size > 1 else step


def _linear_pieces(rows: Array) -> Array:
    """Values at both ends of each piece, shape (2, D - 1, R); a single knot is one piece."""
    return np.stack([rows[:-1], rows[1:]]) if len(rows) > 1 else np.stack([rows, rows])


def _cubic_pieces(knots: Array, rows: Array, n_logarithms: int) -> tuple[Array, tuple[Array, Array]]:
    """Coefficients of the spline's pieces, shape (4, D - 1, R), the constant last, and the range it is kept to."""
    third, second, first, constant = parameter_spline(knots, rows).c
    slack = np.full(rows.shape[1], OVERSHOOT)
    slack[n_logarithms:] = CENTER_OVERSHOOT
    bounds = (rows.min(axis=0) - slack)[:, None], (rows.max(axis=0) + slack)[:, None]
    return np.stack([first, second, third, constant]), bounds


def _log_cosine(angle: Array) -> Array:
    cosine = np.cos(angle)
    np.maximum(cosine, _TINY, out=cosine)
    return np.log(cosine, out=cosine)


def _without_faintest(total: Array) -> Array:
    total -= _FAINTEST
    return np.maximum(total, 0.0, out=total)
