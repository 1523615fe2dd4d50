"""Predict a material at any pair of directions from scattered samples, by layers that are corrected near the samples.

The layers are those of `dsbrdf.samples.sample_layers`. The correction is a factor: the ratio of the samples to the
layers. The logarithm of this factor is a Gaussian process with the kernel

    exp(-|x - x'|**2 / 2) (c + (1 - c) exp(-(y - y')**2 / 2)),

where x has the coordinates log(theta_half + 1.5 degrees) and theta_diff, and y is a rotation out of the plane of
incidence: phi_diff, folded to 0..90 degrees, times sin(theta_diff)**2 and a factor that is 0 at theta_half = 0. The
fraction c of the variance of the logarithm is common to all phi_diff. The length scales and the variance of the kernel
and the noise of the samples have their most probable values. Far from all samples, the prediction equals the layers;
the uncertainty of the prediction there is due to the variance of the factor, and to the differences between structures
of layers that explain the samples equally well.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import half_difference, incident_cosines
from dsbrdf.data.reduction import NORMAL_QUARTILE, OUTLIER_FACTOR
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.samples.sample_layers import CANDIDATES, SampleLayers
from dsbrdf.samples.scattered_samples import ScatteredSamples

# The prediction uses a random subset of this number of samples, because its time grows with the cube of the number.
_MAX_SAMPLES = 800
# The length scales of the kernel and the noise are fitted to a random subset of at most this number of samples.
_MAX_KERNEL_SAMPLES = 500
_ENERGY_ANGLES = np.radians([0.0, 30.0, 60.0, 75.0, 85.0])
_OFFSET = np.radians(1.5)
# Usual length scales of the kernel in log(theta_half + 1.5 degrees), theta_diff and the rotation out of the plane.
_KERNEL_REACH = np.array([0.4, np.radians(15.0), 0.4])
# The most probable of these multiples of the usual length scales is used.
_REACH_SCALES = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 4.0)
# Candidates for the ratio of the variance of the noise to the variance of the kernel.
_NOISE_RATIOS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 10.0, 100.0)
_COMMON_FRACTION = 0.75
# The logarithm of the ratio of a sample to the layers is clipped at this, so that no single sample distorts the rest.
_MAX_LOG_FACTOR = 2.5
_MAX_POINTS_AT_ONCE = 256  # The kernel matrix of this number of points fits in the processor's cache.
_N_FOLDS = 5
_MIN_OUTLIER_LOG = 1e-2


def thinned(samples: ScatteredSamples, max_samples: int = _MAX_SAMPLES) -> ScatteredSamples:
    """Return a random subset of at most `max_samples` samples; equal samples give the same subset."""
    return samples.take(np.random.default_rng(0).permutation(len(samples.values)) < max_samples)


@dataclass(frozen=True, eq=False)
class SamplePrediction:
    """Predict values of a material: the values of layers times the factor by which samples differ from the layers."""

    layers: SampleLayers
    places: Array  # kernel coordinates of the samples, divided by the length scales, axes (sample, coordinate)
    reach: Array  # length scale of the kernel in each of the three coordinates
    root_weight: Array  # square root of the weight of each sample; the weights have the mean 1
    logs: Array  # logarithm of the ratio of a sample to the layers, times root_weight, axes (sample, channel)
    noise: float  # variance of the noise of `logs`, divided by the variance of the correction that `logs` determine

    @classmethod
    def fit(cls, samples: ScatteredSamples, like: "SamplePrediction | None" = None) -> "SamplePrediction":
        """Fit the layers and the factor to samples.

        If `like` is another prediction, its structures of layers, length scales and noise are used without a search.
        """
        layers = SampleLayers.fit(samples, CANDIDATES if like is None else like.layers.candidates)
        angles = half_difference(samples.omega_in, samples.omega_out)
        ratio = (samples.values + layers.dark) / (layers.evaluate_unmasked(*angles) + layers.dark)
        root = np.sqrt(samples.weight / samples.weight.mean())
        logs = np.clip(np.log(ratio), -_MAX_LOG_FACTOR, _MAX_LOG_FACTOR) * root[:, np.newaxis]
        x = _places(*angles)
        few = np.random.default_rng(0).permutation(root.size)[:_MAX_KERNEL_SAMPLES]
        reach, noise = _most_probable(x[few], root[few], logs[few]) if like is None else (like.reach, like.noise)
        return cls(layers, x / reach, reach, root, logs, noise)

    @cached_property
    def _eigen(self) -> tuple[Array, Array]:
        return _eigen(self.places, self.root_weight)

    @cached_property
    def _coefficients(self) -> Array:
        values, vectors = self._eigen
        return np.asarray(vectors @ ((vectors.T @ self.logs) / (values + self.noise)[:, np.newaxis]))

    @cached_property
    def variance(self) -> float:
        """Return the variance of the logarithm of the factor by which samples differ from the layers."""
        values, vectors = self._eigen
        return float(np.mean((vectors.T @ self.logs) ** 2 / (values + self.noise)[:, np.newaxis]))

    @cached_property
    def albedo(self) -> Array:
        """Return the directional albedo (angles, 3) of the values without a bound of energy, at `_ENERGY_ANGLES`."""
        return directional_albedo(self.unbounded, _ENERGY_ANGLES)

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the predicted values (n, 3) [1/sr] at angles (n,).

        A material must not reflect more light than it receives. Therefore a value is divided by the albedo at the
        angle of omega_in to the normal, and by the albedo at the angle of omega_out, if the albedo is above 1.
        """
        values = self.unbounded(theta_half, theta_diff, phi_diff)
        if self.albedo.max() <= 1.0:
            return values
        excess = np.log(np.maximum(self.albedo, 1.0)).T
        for cosine in incident_cosines(theta_half, theta_diff, phi_diff):
            angle = np.arccos(np.clip(cosine, 0.0, 1.0))
            values *= np.exp(-np.stack([np.interp(angle, _ENERGY_ANGLES, channel) for channel in excess], axis=1))
        return values

    def unbounded(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,), which may violate energy conservation."""
        angles = theta_half, theta_diff, phi_diff
        return self.likely(*angles) * np.exp(
            -self.unknown_fraction(*angles)[:, np.newaxis] * self.layers.caution(*angles)
        )

    def likely(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the most likely values (n, 3) [1/sr] at angles (n,): the values of the layers times the factor."""
        layers, dark = self.layers.evaluate_unmasked(theta_half, theta_diff, phi_diff), self.layers.dark
        logs = np.concatenate([near @ self._coefficients for near in self._near(theta_half, theta_diff, phi_diff)])
        return np.maximum((layers + dark) * np.exp(logs) - dark, 0.0)

    def spread(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the standard deviation (n,) of the logarithm of the predicted values at angles (n,)."""
        angles = theta_half, theta_diff, phi_diff
        return np.asarray(np.sqrt(self.unknown_fraction(*angles) * (self.variance + self.layers.spread(*angles) ** 2)))

    def unknown_fraction(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the fraction (n,) of the factor's variance that samples leave: 0 near many samples, 1 far from all."""
        values, vectors = self._eigen
        known = vectors[:, values > self.noise] / np.sqrt(values[values > self.noise] + self.noise)
        blocks = self._near(theta_half, theta_diff, phi_diff)
        return np.maximum(1.0 - np.concatenate([np.sum((near @ known) ** 2, axis=1) for near in blocks]), 0.0)

    def remoteness(self, theta_half: Array, theta_diff: Array, phi_diff: Array, samples: ScatteredSamples) -> Array:
        """Return the distance of angles (n,) from the nearest sample, scaled to 0 at a sample and to 1 far from all."""
        from scipy.spatial import cKDTree  # This slow import is here, because fits of grids do not need it.

        known = _places(*half_difference(samples.omega_in, samples.omega_out)) / self.reach
        distance, _ = cKDTree(known).query(_places(theta_half, theta_diff, phi_diff) / self.reach)
        return np.asarray(1.0 - np.exp(-(distance**2)))

    @property
    def noise_variance(self) -> float:
        """Return the variance of the logarithm of a sample that is due to noise alone."""
        return self.noise * self.variance

    def covariance(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the covariance (n, n) of the logarithms of the predicted values at angles (n,)."""
        angles = theta_half, theta_diff, phi_diff
        values, vectors = self._eigen
        near = np.concatenate([*self._near(*angles)]) @ vectors / np.sqrt(values + self.noise)
        places = _places(*angles) / self.reach
        spread = np.sqrt(self.variance + self.layers.spread(*angles) ** 2)
        return np.asarray((_kernel(places, places) - near @ near.T) * spread * spread[:, np.newaxis])

    def _near(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        places = _places(theta_half, theta_diff, phi_diff) / self.reach
        for start in range(0, max(len(places), 1), _MAX_POINTS_AT_ONCE):
            yield _kernel(places[start : start + _MAX_POINTS_AT_ONCE], self.places) * self.root_weight


def without_outliers(samples: ScatteredSamples) -> ScatteredSamples:
    """Leave out samples far from the prediction, first from all samples, then from the remaining samples."""
    kept = samples
    for _ in range(2):
        prediction = SamplePrediction.fit(thinned(kept))
        expected = prediction.evaluate_unmasked(*half_difference(samples.omega_in, samples.omega_out))
        dark = prediction.layers.dark
        off = np.max(np.abs(np.log((samples.values + dark) / (expected + dark))), axis=1)
        usual = float(np.quantile(off, 0.75)) / NORMAL_QUARTILE
        kept = samples.take(off <= OUTLIER_FACTOR * usual + _MIN_OUTLIER_LOG)
    return kept


def left_out_predictions(samples: ScatteredSamples, prediction: SamplePrediction) -> Array:
    """Return values (n, 3) at the samples, each predicted without its sample by five-fold cross-validation."""
    fold = np.random.default_rng(1).permutation(len(samples.values)) % _N_FOLDS
    values = np.empty(samples.values.shape)
    for number in range(_N_FOLDS):
        rest, out = samples.take(fold != number), samples.take(fold == number)
        angles = half_difference(out.omega_in, out.omega_out)
        is_lit = rest.values.any()
        values[fold == number] = SamplePrediction.fit(rest, prediction).likely(*angles) if is_lit else 0.0
    return values


def _places(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
    folded = np.arccos(np.abs(np.cos(phi_diff)))
    across = np.sin(theta_diff) ** 2 * folded * theta_half / (theta_half + _OFFSET)
    return np.stack([np.log(theta_half + _OFFSET), theta_diff, across], axis=-1)


def smooth_covariance(theta_half: Array, theta_diff: Array, phi_diff: Array, scale: float) -> Array:
    """Return the kernel (n, n) between angles (n,), with the usual length scales times `scale`."""
    places = _places(theta_half, theta_diff, phi_diff) / (scale * _KERNEL_REACH)
    return _kernel(places, places)


def _kernel(first: Array, second: Array) -> Array:
    along, across = (_gaussian(first[:, part], second[:, part]) for part in (slice(2), slice(2, 3)))
    return along * (_COMMON_FRACTION + (1.0 - _COMMON_FRACTION) * across)


def _gaussian(first: Array, second: Array) -> Array:
    """Return exp(-d**2 / 2) for the distance d of each first point from each second point."""
    here, there = (-0.5 * np.sum(points**2, axis=1, keepdims=True) for points in (first, second))
    left, right = np.hstack([first, here, np.ones_like(here)]), np.hstack([second, np.ones_like(there), there])
    return np.asarray(np.exp(np.minimum(left @ right.T, 0.0)))


def _eigen(places: Array, root: Array) -> tuple[Array, Array]:
    values, vectors = np.linalg.eigh(_kernel(places, places) * root * root[:, np.newaxis])
    return np.maximum(values, 0.0), vectors


def _most_probable(x: Array, root: Array, logs: Array) -> tuple[Array, float]:
    """Return the most probable length scales of the kernel, and the most probable ratio of noise to variance."""
    found: list[tuple[float, Array, float]] = []
    for scale in _REACH_SCALES:
        reach = scale * _KERNEL_REACH
        values, vectors = _eigen(x / reach, root)
        along = (vectors.T @ logs) ** 2
        for noise in _NOISE_RATIOS:
            variance = np.mean(along / (values + noise)[:, np.newaxis]) + 1e-12
            probability = -np.log(variance) * root.size - np.sum(np.log(values + noise))
            found.append((float(probability), reach, noise))
    return max(found, key=itemgetter(0))[1:]
