"""Values, density and samples of a model on the numbers of a variant of Mitsuba.

Formulas and names are those of `dsbrdf.model.evaluation` and `dsbrdf.model.sampling`, in single precision.
"""

from importlib import import_module
from typing import NamedTuple

import numpy as np

from dsbrdf.data.grid import CENTER_CUTOFF
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import GRAZING_COSINE
from dsbrdf.model.sampling import ANGLES, DirectionSampler
from dsbrdf.output.export.mitsuba_math import Number, Table, expm1, find, lobe_value, log1p
from dsbrdf.output.export.single_precision import bernstein_pieces

__all__ = ["MitsubaModel"]

_DISC = 1.0 - float(np.cos(CENTER_CUTOFF))
"""Of the cosine of theta_half, over the disc of the delta term."""


class _Angles(NamedTuple):
    """Where a model is evaluated."""

    theta_diff: Number
    tan_half: Number
    squared: Number
    """tan(theta_half)**2, never infinite."""
    cos2_phi: Number
    log_cos: Number


class _Place(NamedTuple):
    """A piece of the polynomials, and where in it a point is, from 0 to 1."""

    piece: Number
    at: Number


class MitsubaModel:
    """A model in the arrays of the variant of Mitsuba that is set.

    Parameters
    ----------
    model : DSBRDF
    """

    def __init__(self, model: DSBRDF) -> None:
        self._dr, self._mitsuba = import_module("drjit"), import_module("mitsuba")
        pieces = bernstein_pieces(model, "Mitsuba")
        self._model = model
        self._n_rows, self._n_pieces = pieces.coefficients.shape[:2]
        self._coefficients = Table(pieces.coefficients)
        self._breaks = pieces.breaks.tolist()
        self._starts, self._widths = Table(pieces.breaks), Table(np.diff(pieces.breaks))
        self._sampling = _SamplingTables(model.sampler)

    def brdf(self, omega_in: Number, omega_out: Number) -> list[Number]:
        """Values in red, green and blue [1/sr] of directions above the horizon."""
        angles = self._angles(omega_in, omega_out)
        place = self._place(angles.theta_diff)
        dr, model, k = self._dr, self._model, self._model.n_lobes
        spline, n_shapes = model.interpolation == "spline", model.kappa.shape[0]
        result: list[Number] = [self._mitsuba.Float(0.0)] * 3
        for lobe in range(k):
            squared = angles.squared
            if model.elongation[:, lobe].any():
                ratio = dr.exp(self._row((3 + 3 * n_shapes) * k + lobe, place) * angles.log_cos)
                squared = squared * (angles.cos2_phi / ratio + (1.0 - angles.cos2_phi) * ratio)
            values = [self._lobe(3 * k + c * k + lobe, n_shapes * k, lobe, place, squared) for c in range(n_shapes)]
            for channel in range(3):
                height = self._row(channel * k + lobe, place)
                amplitude = dr.exp(height) if spline else expm1(height)
                result[channel] = result[channel] + amplitude * values[channel % n_shapes]
        if model.delta.any():
            inside = angles.tan_half < float(np.tan(CENTER_CUTOFF))
            for channel in range(3):
                result[channel] += dr.select(inside, self._row(self._n_rows - 3 + channel, place), 0.0)
        return result

    def pdf(self, omega_in: Number, omega_out: Number) -> Number:
        """Density per solid angle [1/sr] of omega_in, both directions being above the horizon."""
        dr, tables = self._dr, self._sampling
        total = omega_in + omega_out
        length, height = dr.norm(total), dr.maximum(total.z, 1e-12)
        heading = self._heading(omega_out)
        along = ((total.x * heading[0] + total.y * heading[1]) / height) ** 2
        across = ((total.y * heading[0] - total.x * heading[1]) / height) ** 2
        cos_half, row = height / length, self._row_of(omega_out)
        result = self._mitsuba.Float(0.0)
        for lobe in range(tables.n_lobes):
            ratio = tables.ratio[row * tables.n_lobes + lobe]
            squared = along / ratio + across * ratio
            slope = (1.0 + squared) * cos_half * cos_half
            density = tables.density(row, lobe, squared) / (slope * dr.sqrt(slope))
            result = result + tables.share[row * tables.width + lobe] * density
        inside = along + across < float(np.tan(CENTER_CUTOFF)) ** 2
        disc = tables.share[row * tables.width + tables.n_lobes] / (2.0 * np.pi * _DISC)
        result = (result + dr.select(inside, disc, 0.0)) / (2.0 * length)
        return result + tables.share[row * tables.width + tables.n_lobes + 1] * omega_in.z / np.pi

    def sample(self, omega_out: Number, one: Number, two: Number) -> Number:
        """Direction omega_in, perhaps below the horizon, from one and from two uniform numbers."""
        dr, tables = self._dr, self._sampling
        row = self._row_of(omega_out)
        chosen = find(tables.cumulative, row * tables.width, tables.width, one)
        # What is left of the number that chose the lobe is uniform again.
        share = tables.share[row * tables.width + chosen]
        rest = one - tables.cumulative[row * tables.width + chosen] + share
        rest = dr.clip(rest / dr.maximum(share, 1e-12), 0.0, 1.0 - 1e-7)
        is_lobe = chosen < tables.n_lobes
        tangent = dr.sqrt(rest * _DISC * (2.0 - rest * _DISC)) / (1.0 - rest * _DISC)
        half_ratio: Number = 1.0
        if tables.n_lobes:
            lobe = row * tables.n_lobes + dr.select(is_lobe, chosen, 0)
            tangent = dr.select(is_lobe, tables.tangent(lobe, rest, two.x), tangent)
            half_ratio = dr.select(is_lobe, dr.sqrt(tables.ratio[lobe]), 1.0)
        azimuth = 2.0 * np.pi * two.y
        along, across = tangent * dr.cos(azimuth) * half_ratio, tangent * dr.sin(azimuth) / half_ratio
        x, y = self._heading(omega_out)
        half = dr.normalize(self._mitsuba.Vector3f(along * x - across * y, along * y + across * x, 1.0))
        mirrored = 2.0 * dr.dot(half, omega_out) * half - omega_out
        even = self._mitsuba.warp.square_to_cosine_hemisphere(two)
        return dr.select(chosen > tables.n_lobes, even, mirrored)

    def _angles(self, omega_in: Number, omega_out: Number) -> _Angles:
        dr = self._dr
        total, difference = omega_in + omega_out, omega_in - omega_out
        sum2, difference2 = dr.maximum(dr.squared_norm(total), 1e-30), dr.squared_norm(difference)
        radius2 = total.x * total.x + total.y * total.y
        radius, height = dr.sqrt(radius2), dr.maximum(total.z, 1e-15)
        x, y = self._heading(total)
        # The difference along and across the heading of the half vector.
        along = ((x * difference.x + y * difference.y) * total.z - radius * difference.z) * dr.rsqrt(sum2)
        across = x * difference.y - y * difference.x
        length2 = along * along + across * across
        cos2_phi = dr.select(length2 > 0.0, along * along / dr.maximum(length2, 1e-30), 1.0)
        cos2_diff = sum2 / (sum2 + difference2)
        fourth = GRAZING_COSINE**4
        log_cos = 0.25 * dr.log(fourth + (1.0 - fourth) * cos2_diff * cos2_diff)
        theta_diff = dr.atan2(dr.sqrt(difference2), dr.sqrt(sum2))
        squared = dr.minimum(radius2 / (height * height), 1e30)
        return _Angles(theta_diff, radius / height, squared, cos2_phi, log_cos)

    def _place(self, theta_diff: Number) -> _Place:
        dr = self._dr
        held = dr.clip(theta_diff, self._breaks[0], self._breaks[-1])
        piece = self._mitsuba.UInt32(0)
        for index in range(1, self._n_pieces):
            piece = dr.select(held >= self._breaks[index], index, piece)
        return _Place(piece, (held - self._starts[piece]) / self._widths[piece])

    def _row(self, row: int, place: _Place) -> Number:
        start = (row * self._n_pieces + place.piece) * 4
        first, second, third, last = (self._coefficients[start + i] for i in range(4))
        t = place.at
        s = 1.0 - t
        return s * s * (s * first + 3.0 * t * second) + t * t * (3.0 * s * third + t * last)

    def _lobe(self, row: int, step: int, lobe: int, place: _Place, squared: Number) -> Number:
        """Value of a lobe whose kappa is in a row, with gamma and center a step and two steps after it."""
        kappa, gamma = self._row(row, place), self._row(row + step, place)
        if self._model.interpolation == "spline":
            kappa, gamma = self._dr.exp(kappa), self._dr.exp(gamma)
        center = self._row(row + 2 * step, place) if self._model.is_ring[lobe] else None
        return lobe_value(squared, kappa, gamma, center, self._model.lobe)

    def _heading(self, omega: Number) -> tuple[Number, Number]:
        """Cosine and sine of the azimuth, 1 and 0 along the normal."""
        radius = self._dr.sqrt(omega.x * omega.x + omega.y * omega.y)
        inverse = self._dr.rcp(self._dr.maximum(radius, 1e-30))
        return self._dr.select(radius > 0.0, omega.x * inverse, 1.0), omega.y * inverse

    def _row_of(self, omega_out: Number) -> Number:
        """Index in `ANGLES` of the angle nearest to a direction."""
        dr = self._dr
        theta = dr.atan2(dr.sqrt(omega_out.x * omega_out.x + omega_out.y * omega_out.y), omega_out.z)
        nearest = dr.clip(dr.round(theta / float(ANGLES[1])), 0.0, float(ANGLES.size - 1))
        return self._mitsuba.UInt32(nearest)


class _SamplingTables:
    """The tables of a `DirectionSampler`."""

    def __init__(self, sampler: DirectionSampler) -> None:
        self._dr = import_module("drjit")
        lobes, self._family = sampler.lobes, sampler.lobes.family
        self.n_lobes = sampler.log_ratio.shape[1]
        self.width = self.n_lobes + 2
        self.ratio = Table(np.exp(sampler.log_ratio))
        self.cumulative = Table(sampler.cumulative)
        self.share = Table(np.diff(sampler.cumulative, axis=1, prepend=0.0))
        self._is_series, self._series_flag = sampler.is_series, Table(sampler.is_series)
        self._kappa, self._gamma = Table(lobes.kappa), Table(lobes.gamma)
        self._scale = Table(np.expm1(lobes.kappa) / sampler.energy)
        self._terms, self._n_terms = Table(sampler.terms), sampler.terms.shape[2]
        self._n_edges = sampler.edges.shape[2]
        self._edges, self._cells = Table(sampler.edges), Table(sampler.cells)
        square = np.sin(0.5 * sampler.edges) ** 2
        self._square = Table(square)
        self._density = Table(np.diff(sampler.cells, axis=2) / np.maximum(4.0 * np.pi * np.diff(square, axis=2), 1e-30))

    def density(self, row: Number, lobe: int, squared: Number) -> Number:
        """Density of theta' per solid angle, from tan(theta')**2."""
        at = row * self.n_lobes + lobe
        if self._is_series[lobe]:
            return lobe_value(squared, self._kappa[at], self._gamma[at], None, self._family) * self._scale[at]
        theta = self._dr.atan(self._dr.sqrt(squared))
        cell = find(self._edges, at * self._n_edges + 1, self._n_edges - 1, theta)
        return self._density[at * (self._n_edges - 1) + cell]

    def tangent(self, lobe: Number, first: Number, second: Number) -> Number:
        """tan(theta') drawn for lobes, given by their index in the tables, from two uniform numbers."""
        dr = self._dr
        series = cells = None
        if self._is_series.any():
            n = 1.0 + find(self._terms, lobe * self._n_terms, self._n_terms, first)
            # minus log(1 - second), exact where it is small
            fall = log1p(second / dr.maximum(1.0 - second, 1e-8)) / (n * self._gamma[lobe] + 1.0)
            series = dr.sqrt(expm1(dr.minimum(2.0 * fall, 60.0)))
        if not self._is_series.all():
            start = lobe * self._n_edges
            cell = find(self._cells, start + 1, self._n_edges - 1, first)
            low, high = self._square[start + cell], self._square[start + cell + 1]
            sine2 = dr.minimum(low + second * (high - low), 0.5)
            # tan(2 asin(s)) = 2 s sqrt(1 - s**2) / (1 - 2 s**2)
            cells = 2.0 * dr.sqrt(sine2 * (1.0 - sine2)) / dr.maximum(1.0 - 2.0 * sine2, 1e-12)
        if series is None or cells is None:
            return cells if series is None else series
        return dr.select(self._series_flag[lobe % self.n_lobes] > 0.5, series, cells)
