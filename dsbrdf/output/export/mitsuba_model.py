"""Evaluate and sample a model in the arrays of Mitsuba 3, with differentiable parameters.

Formulas and names are as in `dsbrdf.model.evaluation` and `dsbrdf.model.sampling`, in single precision. Mitsuba follows
a path from the camera, so that Mitsuba's ``si.wi`` is omega_out of the model, and ``wo`` is omega_in. Numbers are
floats of Python or arrays of drjit. The functions ``expm1`` and ``log1p``, which drjit lacks, are computed by series
near 0. The derivatives of a branch that is not taken must be finite too, because drjit multiplies these derivatives by
0, and 0 times infinity is not 0.
"""

from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import CENTER_CUTOFF
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import GRAZING_COSINE
from dsbrdf.model.sampling import ANGLES
from dsbrdf.output.export.single_precision import bernstein_bases, bernstein_pieces

Number = Any
"""A float or int of Python, or an array of drjit."""
PARAMETERS = ("amplitude", "kappa", "gamma", "center", "elongation")
"""Names of the arrays of `DSBRDF` that can be changed in Mitsuba."""
_MIN_LOG_PARAMETER = 1e-9  # Parameters that are interpolated as logarithms are clipped at this minimum.


class Table:
    """Look up the numbers of an array by their index in the flattened array."""

    def __init__(self, values: Any) -> None:
        self._drjit, self._float = import_module("drjit"), import_module("mitsuba").Float
        if self._drjit.is_array_v(values):
            self._values = values
        else:
            flat = np.ravel(np.asarray(values, dtype=np.float32))
            self._values = flat.tolist() if self._float is float else self._float(flat)

    def __getitem__(self, index: Number) -> Number:
        return self._values[index] if self._float is float else self._drjit.gather(self._float, self._values, index)


def _log1p(x: Number) -> Number:
    """Return the logarithm of 1 + x for x >= 0."""
    dr = import_module("drjit")
    s = x / (2.0 + x)
    t = s * s
    series = 2.0 * s * (1.0 + t * (1.0 / 3.0 + t * (0.2 + t * (1.0 / 7.0 + t * (1.0 / 9.0)))))
    return dr.select(x < 0.5, series, dr.log(1.0 + x))


def _expm1(x: Number) -> Number:
    """Return exp(x) - 1."""
    dr = import_module("drjit")
    y = dr.clip(x, -0.3, 0.3)
    series = y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0))))))
    return dr.select(dr.abs(x) < 0.3, series, dr.exp(dr.clip(x, -80.0, 88.0)) - 1.0)


def _safe_root(x: Number) -> Number:
    """Return the square root of x >= 0, with derivative 0 at 0."""
    dr = import_module("drjit")
    positive = x > 0.0
    return dr.select(positive, dr.sqrt(dr.select(positive, x, 1.0)), 0.0)


class MitsubaModel:
    """Evaluate and sample a model in the arrays of the active variant of Mitsuba.

    The dict `parameters` has a tensor for each name in `PARAMETERS`; call `update` after a change of a tensor. The
    tensors have the shapes of the arrays in `DSBRDF`, except that center has only the ring lobes, and elongation only
    the lobes that are not round.
    """

    def __init__(self, model: DSBRDF) -> None:
        self._dr, self._mitsuba = import_module("drjit"), import_module("mitsuba")
        breaks, coefficients = bernstein_pieces(model, "Mitsuba")
        self._lobes_with = dict.fromkeys(PARAMETERS, np.ones(model.n_lobes, np.bool_))
        self._lobes_with |= {"center": model.is_ring, "elongation": np.asarray(model.elongation.any(axis=0))}
        self.parameters: dict[str, Any] = {
            name: self._mitsuba.TensorXf(getattr(model, name)[..., lobes].astype(np.float32))
            for name, lobes in self._lobes_with.items()
            if lobes.any()
        }
        self._delta = coefficients[-3:]
        self._model = model
        self._n_rows, self._n_pieces = coefficients.shape[:2]
        self._breaks = breaks.tolist()
        self._starts, self._widths = Table(breaks), Table(np.diff(breaks))
        sampler = model.sampler
        self._mixture_width = sampler.cumulative.shape[1]
        self._mixture_along, self._mixture_across = Table(sampler.along), Table(sampler.across)
        self._mixture_cumulative = Table(sampler.cumulative)
        self._mixture_share = Table(np.diff(sampler.cumulative, axis=1, prepend=0.0))
        self.update()

    def changed_model(self) -> DSBRDF:
        """Return the model with the current parameters."""
        arrays = {name: np.array(getattr(self._model, name)) for name in self.parameters}
        for name, tensor in self.parameters.items():
            changed = arrays[name][..., self._lobes_with[name]]
            arrays[name][..., self._lobes_with[name]] = np.array(tensor, dtype=np.float64).reshape(changed.shape)
        for name in self._bounds:
            arrays[name] = np.maximum(arrays[name], self._bounds[name])
        return replace(self._model, **arrays)  # type: ignore[arg-type]  # Fields with these names are arrays.

    @property
    def _bounds(self) -> dict[str, float]:
        """Return the minimum of each bounded parameter, which is above 0 if the model is undefined at 0."""
        least = _MIN_LOG_PARAMETER if self._model.interpolation == "spline" else 0.0
        return {"amplitude": least, "kappa": _MIN_LOG_PARAMETER, "gamma": least}

    def update(self) -> None:
        """Recompute the model from the current parameters; the density of sampled directions does not change."""
        if self._mitsuba.Float is float:
            self._coefficients = Table(bernstein_pieces(self.changed_model(), "Mitsuba")[1])
            return
        rows = [self._rows_of(name, basis) for name, basis in bernstein_bases(self._model).items()]
        self._coefficients = Table(self._dr.concat([*rows, self._mitsuba.Float(np.ravel(self._delta))]))

    def _rows_of(self, name: str, basis: Array) -> Number:
        """Return the Bernstein coefficients of a parameter, as a flat array with the axes (row, piece, coefficient)."""
        dr, index = self._dr, self._mitsuba.UInt32
        shape = getattr(self._model, name).shape
        values = self._mitsuba.Float(0.0)
        if name in self.parameters:
            stored = np.broadcast_to(self._lobes_with[name], shape).ravel()
            place = index(np.maximum(np.cumsum(stored) - 1, 0).astype(np.uint32))
            tensor = self._mitsuba.Float(self.parameters[name].array)
            values = dr.gather(self._mitsuba.Float, tensor, place, self._mitsuba.Bool(stored))
        if name in self._bounds:
            values = dr.maximum(values, self._bounds[name])
            if self._model.interpolation == "spline":
                values = dr.log(values)
            elif name == "amplitude":
                values = _log1p(values)
        n_controls, n_lobes = shape[-2:]
        n_rows, size = int(np.prod(shape[:-2])) * n_lobes, basis[0].size
        row, place = (index(part.astype(np.uint32).ravel()) for part in np.indices((n_rows, size)))
        first = row // n_lobes * (n_controls * n_lobes) + row % n_lobes
        table, total = Table(basis), self._mitsuba.Float(0.0)
        for control in range(n_controls):
            value = dr.gather(self._mitsuba.Float, values, first + control * n_lobes)
            total = total + table[place + control * size] * value
        return total

    def brdf(self, omega_in: Number, omega_out: Number) -> list[Number]:
        """Return RGB values [1/sr] for directions above the horizon."""
        theta_diff, tan_half, squared_half, cos2_phi, log_cos = self._angles(omega_in, omega_out)
        place = self._place(theta_diff)
        dr, model, k = self._dr, self._model, self._model.n_lobes
        spline, n_shapes = model.interpolation == "spline", model.kappa.shape[0]
        result: list[Number] = [self._mitsuba.Float(0.0)] * 3
        for lobe in range(k):
            squared = squared_half
            if model.elongation[:, lobe].any():
                ratio = dr.exp(self._row((3 + 3 * n_shapes) * k + lobe, place) * log_cos)
                squared = squared * (cos2_phi / ratio + (1.0 - cos2_phi) * ratio)
            values = [self._lobe(3 * k + c * k + lobe, n_shapes * k, lobe, place, squared) for c in range(n_shapes)]
            for channel in range(3):
                height = self._row(channel * k + lobe, place)
                amplitude = dr.exp(height) if spline else _expm1(height)
                result[channel] = result[channel] + amplitude * values[channel % n_shapes]
        if model.delta.any():
            inside = tan_half < float(np.tan(CENTER_CUTOFF))
            for channel in range(3):
                result[channel] += dr.select(inside, self._row(self._n_rows - 3 + channel, place), 0.0)
        return result

    def pdf(self, omega_in: Number, omega_out: Number) -> Number:
        """Return the density per solid angle [1/sr] of omega_in, for directions above the horizon."""
        dr, width = self._dr, self._mixture_width
        total, row = omega_in + omega_out, self._row_of(omega_out)
        x, y = self._heading(omega_out)
        toward2, aside2 = (total.x * x + total.y * y) ** 2, (total.y * x - total.x * y) ** 2
        height2, length2 = total.z * total.z, dr.squared_norm(total)
        radius2 = omega_out.x * omega_out.x + omega_out.y * omega_out.y
        result = self._mixture_share[row * width + width - 1] * omega_in.z / np.pi
        for part in range(width - 1):
            at = row * (width - 1) + part
            along, across = self._mixture_along[at], self._mixture_across[at]
            slopes = height2 + toward2 / (along * along) + aside2 / (across * across)
            visible = omega_out.z + dr.sqrt(omega_out.z * omega_out.z + along * along * radius2)
            density = (length2 / slopes) ** 2 / (2.0 * np.pi * along * across * visible)
            result = result + self._mixture_share[row * width + part] * density
        return result

    def sample(self, omega_out: Number, one: Number, two: Number) -> Number:
        """Draw omega_in, possibly below the horizon, from a uniform random number `one` and a pair of them, `two`."""
        dr, width = self._dr, self._mixture_width
        row = self._row_of(omega_out)
        chosen = self._mitsuba.UInt32(0)
        for part in range(width - 1):
            chosen = dr.select(one >= self._mixture_cumulative[row * width + part], part + 1, chosen)
        at = row * (width - 1) + dr.minimum(chosen, width - 2)
        half = self._visible_normal(omega_out, self._mixture_along[at], self._mixture_across[at], two)
        mirrored = 2.0 * dr.dot(half, omega_out) * half - omega_out
        even = self._mitsuba.warp.square_to_cosine_hemisphere(two)
        return dr.select(chosen == width - 1, even, mirrored)

    def _visible_normal(self, omega_out: Number, along: Number, across: Number, two: Number) -> Number:
        dr = self._dr
        x, y = self._heading(omega_out)
        radius = _safe_root(omega_out.x * omega_out.x + omega_out.y * omega_out.y)
        seen = dr.normalize(self._mitsuba.Vector2f(along * radius, omega_out.z))
        z = (1.0 - two.x) * (1.0 + seen.y) - seen.y
        ring, turn = dr.sqrt(dr.maximum(1.0 - z * z, 0.0)), 2.0 * np.pi * two.y
        toward, aside = along * (ring * dr.cos(turn) + seen.x), across * ring * dr.sin(turn)
        return dr.normalize(self._mitsuba.Vector3f(toward * x - aside * y, toward * y + aside * x, z + seen.y))

    def _angles(self, omega_in: Number, omega_out: Number) -> tuple[Number, ...]:
        """Return theta_diff, tan(theta_half), the clipped square of this tangent, cos(phi_diff)**2 and a logarithm.

        The elongation of a lobe times the last logarithm is the logarithm of the ratio of the lobe's two widths.
        """
        dr = self._dr
        total, difference = omega_in + omega_out, omega_in - omega_out
        sum2, difference2 = dr.maximum(dr.squared_norm(total), 1e-30), dr.squared_norm(difference)
        radius2 = total.x * total.x + total.y * total.y
        radius, height = _safe_root(radius2), dr.maximum(total.z, 1e-7)
        x, y = self._heading(total)
        # The difference of the directions is projected along and across the azimuth of the half vector.
        along = ((x * difference.x + y * difference.y) * total.z - radius * difference.z) * dr.rsqrt(sum2)
        across = x * difference.y - y * difference.x
        length2 = along * along + across * across
        some = length2 > 1e-30
        cos2_phi = dr.select(some, along * along / dr.select(some, length2, 1.0), 1.0)
        cos2_diff = sum2 / (sum2 + difference2)
        fourth = GRAZING_COSINE**4
        log_cos = 0.25 * dr.log(fourth + (1.0 - fourth) * cos2_diff * cos2_diff)
        theta_diff = dr.atan2(_safe_root(difference2), dr.sqrt(sum2))
        squared = dr.minimum(radius2 / (height * height), 1e30)
        return theta_diff, radius / height, squared, cos2_phi, log_cos

    def _place(self, theta_diff: Number) -> tuple[Number, Number]:
        """Return the index of the polynomial piece at theta_diff, and the position in this piece from 0 to 1."""
        dr = self._dr
        held = dr.clip(theta_diff, self._breaks[0], self._breaks[-1])
        piece = self._mitsuba.UInt32(0)
        for index in range(1, self._n_pieces):
            piece = dr.select(held >= self._breaks[index], index, piece)
        return piece, (held - self._starts[piece]) / self._widths[piece]

    def _row(self, row: int, place: tuple[Number, Number]) -> Number:
        piece, t = place
        start = (row * self._n_pieces + piece) * 4
        first, second, third, last = (self._coefficients[start + i] for i in range(4))
        s = 1.0 - t
        return s * s * (s * first + 3.0 * t * second) + t * t * (3.0 * s * third + t * last)

    def _lobe(self, row: int, step: int, lobe: int, place: tuple[Number, Number], squared: Number) -> Number:
        """Return the value of a lobe with the maximum 1.

        The parameter kappa is in `row` of the coefficients, gamma in `row + step`, and center in `row + 2 step`.
        """
        dr, kappa, gamma = self._dr, self._row(row, place), self._row(row + step, place)
        if self._model.interpolation == "spline":
            kappa, gamma = dr.exp(kappa), dr.exp(gamma)
        top_squared: Number = 0.0
        if self._model.is_ring[lobe]:
            root, tan_center = _safe_root(squared), dr.tan(self._row(row + 2 * step, place))
            tangent = dr.clip((root - tan_center) / (1.0 + root * dr.maximum(tan_center, 0.0)), -1e12, 1e12)
            squared, top_squared = tangent * tangent, dr.minimum(tan_center, 0.0) ** 2
        if self._model.lobe == "student":
            return dr.exp(-kappa * (_log1p(gamma * squared) - _log1p(gamma * top_squared)))
        log_cos, log_cos_top = -0.5 * _log1p(squared), -0.5 * _log1p(top_squared)
        top, log_ratio = kappa * dr.exp(gamma * log_cos_top), gamma * (log_cos - log_cos_top)
        # The value is expm1(top * exp(log_ratio)) / expm1(top), written in a form without overflow.
        return dr.exp(top * _expm1(log_ratio)) * _expm1(-top * dr.exp(log_ratio)) / _expm1(-top)

    def _heading(self, omega: Number) -> tuple[Number, Number]:
        """Return cosine and sine of the azimuth of a direction; 1 and 0 for the direction of the normal."""
        radius2 = omega.x * omega.x + omega.y * omega.y
        some = radius2 > 1e-30
        inverse = self._dr.rsqrt(self._dr.select(some, radius2, 1.0))
        return self._dr.select(some, omega.x * inverse, 1.0), self._dr.select(some, omega.y * inverse, 0.0)

    def _row_of(self, omega_out: Number) -> Number:
        """Return the index in `ANGLES` of the angle that is nearest to the direction's angle to the normal."""
        dr = self._dr
        theta = dr.atan2(_safe_root(omega_out.x * omega_out.x + omega_out.y * omega_out.y), omega_out.z)
        nearest = dr.clip(dr.round(theta / float(ANGLES[1])), 0.0, float(ANGLES.size - 1))
        return self._mitsuba.UInt32(nearest)
