"""Measure how far a model is from the measurement to which it was fitted.

For a measurement f on a grid, all channels and nodes have equal weights. Nodes count if they are valid, both directions
are within the horizon cutoff of the normal, theta_half is at least 1 degree, and phi_diff is an even number of degrees:

    relative_rms    = sqrt( sum (f - fit)**2 / sum f**2 )
    floor           = relative_rms of the mean of f over phi_diff, the minimum for models that ignore phi_diff
    symmetric_floor = relative_rms of means at phi_diff, -phi_diff, pi - phi_diff, the minimum for reciprocal models
    excess          = relative_rms / floor
    male            = mean | log(1 + f cos_in) - log(1 + fit cos_in) |

For scattered samples, whose directions were chosen freely, relative_rms and symmetric_floor are over all samples within
the cutoff; symmetric_floor is None if no two samples are symmetric. Two further errors are:

    relative_rms_left_out = relative_rms at samples that were left out of the fit
    relative_rms_expected = relative_rms over all directions that the error of one table in ten exceeds

For light and visible differences, over all directions:

    albedo_error = mean over theta_out = 0, 30, 60, 75 degrees and channels of |albedo of fit - of data| / of data
    psnr, ssim   = of a lit sphere, see `dsbrdf.rendering.sphere`
"""

import math
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import CENTER_CUTOFF, CHANNELS, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import used_samples
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.rendering.sphere import render_sphere, sphere_likeness

BANDS = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0, 90.0])
"""Edges of the bands of theta_diff in reports of errors [rad]."""
OUTSIDE_CENTER = THETA_HALF >= CENTER_CUTOFF
"""Nodes of the theta_half axis that the first five metrics, and the paper's procedure, use; shape (90,)."""
ALBEDO_ANGLES = np.radians([0.0, 30.0, 60.0, 75.0])
"""Angles to the normal at which albedos are compared [rad]."""
MIN_FLOOR = 1e-6
"""With a smaller `floor`, data do not depend on phi_diff; `excess` is None, as it would divide by rounding errors."""
MIN_ALBEDO = 1e-9
"""A channel with a smaller albedo is black up to rounding, so its relative albedo error counts as 0."""
SPHERE_PIXELS = 64
ROW_GROUPS = 9
SINGLE: Any = np.float32
PHI_STEP = 2
"""Every second phi_diff is enough: total errors of 71 materials differ by less than 1 % from those of all phi_diff."""


@dataclass(frozen=True)
class RelativeErrors:
    """Errors of a fit over some samples, without unit, by the formulas at the top of this file."""

    relative_rms: float
    floor: float
    symmetric_floor: float
    excess: float | None  # None if `floor` is zero
    male: float


@dataclass(frozen=True)
class ChannelErrors(RelativeErrors):
    """Errors of one channel: "red", "green" or "blue"."""

    channel: str


@dataclass(frozen=True)
class BandErrors(RelativeErrors):
    """Errors in one band of theta_diff, from a first angle to a last angle [rad], which is excluded."""

    theta_diff: tuple[float, float]


@dataclass(frozen=True)
class Metrics:
    """The errors of a whole fit; ``metrics["excess"]`` looks up a metric by its name.

    All metrics are None if only profiles were fitted.

    Attributes
    ----------
    relative_rms_left_out, relative_rms_expected : float or None
        For scattered samples: the error at left-out samples, and an estimate for all directions.
    relative_rms, floor, symmetric_floor, male : float or None
        Errors over the samples that the fit uses, without a unit; the formulas are at the top of this file.
    excess : float or None
        ``relative_rms / floor``; None where the floor is zero.
    albedo_error : float or None
        Mean relative error of the directional albedo.
    psnr, ssim : float or None
        Likeness of a lit sphere: peak signal-to-noise ratio [dB], structural similarity (at most 1).
    """

    relative_rms_left_out: float | None = None
    relative_rms_expected: float | None = None
    relative_rms: float | None = None
    floor: float | None = None
    symmetric_floor: float | None = None
    excess: float | None = None
    male: float | None = None
    albedo_error: float | None = None
    psnr: float | None = None
    ssim: float | None = None

    def __getitem__(self, name: str) -> float | None:
        if name not in METRICS:
            raise KeyError(name)
        value: float | None = getattr(self, name)
        return value


METRICS = tuple(field.name for field in fields(Metrics))
"""Names of the metrics."""


def sample_errors(model: ReflectanceModel, measurement: Measurement, horizon_cutoff: float | None) -> Array:
    """Compare a model with all samples whose directions are within the cutoff of the normal [rad].

    Every `PHI_STEP`-th phi_diff counts, in single precision.

    Returns sums of shape (6, 3 channels, 90 theta_diff): of f**2, of (f - fit)**2, of the squared deviations from the
    means of `floor` and `symmetric_floor`, of |log(1 + f cos_in) - log(1 + fit cos_in)|, and the number of samples.
    Without a cutoff (None), all samples above the horizon count.

    Raises InvalidArgumentError if there is nothing but zeros to compare with.
    """
    sums, phi_diff = np.zeros((6, 3, THETA_DIFF.size)), PHI_DIFF[::PHI_STEP].astype(SINGLE)
    first, every_phi = int(OUTSIDE_CENTER.argmax()), slice(None, None, PHI_STEP)
    used = used_samples(measurement, horizon_cutoff)[:, :, every_phi]
    is_used = np.asarray(used.any(axis=2))
    for rows in np.array_split(np.arange(THETA_DIFF.size), ROW_GROUPS):
        # Columns of theta_half beyond the last used sample are skipped, which saves evaluations of the model.
        last = np.flatnonzero(is_used[:, rows].any(axis=1)).max(initial=-1)
        columns = slice(first, 1 + int(last))
        along, swing = (part(THETA_HALF[columns, None]).astype(SINGLE) for part in (np.cos, np.sin))
        across = swing * np.cos(phi_diff)
        grid = model.evaluate_grid(THETA_HALF[columns], THETA_DIFF[rows], phi_diff[: phi_diff.size // 2 + 1])
        for row, values in zip(rows.tolist(), grid, strict=True):
            # Only the cosine of omega_in to the normal is needed; `incident_cosines` computes both cosines.
            cosine = math.cos(THETA_DIFF[row]) * along - math.sin(THETA_DIFF[row]) * across
            # The model has equal values at phi_diff and at 180 degrees - phi_diff.
            fit = np.concatenate([values, values[:, :, -2:0:-1]], axis=2)
            samples = measurement.values_at(columns, row, every_phi).astype(SINGLE)
            sums[:, :, row] = _row_sums(samples, fit, used[columns, row].astype(SINGLE), cosine)
    if not sums[0].any():
        raise InvalidArgumentError(
            f"there are no data to compare with: from theta_half = {math.degrees(CENTER_CUTOFF):.2g} degrees on, every "
            "sample used is zero or left out"
        )
    return sums


def _row_sums(samples: Array, fit: Array, counted: Array, cosine: Array) -> Array:
    """Return the six sums of `sample_errors` over theta_half and phi_diff at one theta_diff, (6, 3).

    `counted` is 1 for samples that are used, and otherwise 0.
    """
    count, samples = counted.sum(axis=1), samples * counted
    mean = np.sum(samples, axis=2) / np.maximum(count, 1.0)
    deviation = samples - mean[..., None]
    deviation *= counted
    # Samples at phi_diff and 180 degrees - phi_diff deviate from their mean by half of the difference between both.
    half = samples.shape[2] // 2
    one, partner = slice(1, half), slice(None, half, -1)
    step = samples[..., one] - samples[..., partner]
    step *= math.sqrt(0.5) * counted[..., one] * counted[..., partner]
    error = samples - fit
    error *= counted
    squares = [np.einsum("chp,chp->ch", part, part) for part in (samples, error, deviation, step)]
    # The difference of logarithms is log(1 + (f - fit) cos_in / (1 + fit cos_in)), which is accurate for small errors.
    error *= cosine
    error /= 1.0 + fit * cosine
    log_error = np.sum(np.abs(np.log1p(error, out=error), out=error), axis=2)
    return np.stack([*squares, log_error, np.broadcast_to(count, mean.shape)]).sum(axis=2, dtype=float)


def relative_errors(sums: Array, channels: slice = slice(None), rows: slice = slice(None)) -> RelativeErrors | None:
    """Return the errors of some channels and rows of theta_diff, or None if all samples are 0."""
    power, error, scatter, asymmetry, log_error, count = (float(part[channels, rows].sum()) for part in sums)
    if power == 0.0:
        return None
    relative_rms, floor = float(np.sqrt(error / power)), float(np.sqrt(scatter / power))
    return RelativeErrors(
        relative_rms=relative_rms,
        floor=floor,
        symmetric_floor=float(np.sqrt(asymmetry / power)),
        excess=relative_rms / floor if floor > MIN_FLOOR else None,
        male=log_error / count,
    )


def error_tables(sums: Array) -> tuple[tuple[ChannelErrors, ...], tuple[BandErrors, ...]]:
    """Return the errors of each channel that is not black, and of each band of theta_diff with data."""
    by_channel = []
    for index, channel in enumerate(CHANNELS):
        errors = relative_errors(sums, slice(index, index + 1))
        if errors is not None:
            by_channel.append(ChannelErrors(**asdict(errors), channel=channel))
    by_theta_diff = []
    for first, last in pairwise(BANDS):
        start, stop = np.searchsorted(THETA_DIFF, [first - 1e-9, last - 1e-9]).tolist()
        errors = relative_errors(sums, rows=slice(start, stop))
        if errors is not None:
            by_theta_diff.append(BandErrors(**asdict(errors), theta_diff=(float(first), float(last))))
    return tuple(by_channel), tuple(by_theta_diff)


def sample_metrics(model: ReflectanceModel, measurement: Measurement, sums: Array, albedo: Array) -> Metrics:
    """Return all metrics of a model, from `sample_errors` and its albedo (4, 3) at `ALBEDO_ANGLES`.

    PSNR and SSIM compare spheres under three lights; PSNR is at most 200 dB.
    """
    errors, data = relative_errors(sums), measurement.interpolated
    # A table has no lobes narrower than the spacing of its rows, so the quadrature need not be divided at knots.
    measured = directional_albedo(data.evaluate, ALBEDO_ANGLES)
    albedo_error = float(np.mean(np.abs(albedo - measured) / np.where(measured > MIN_ALBEDO, measured, np.inf)))
    lit = render_sphere(data.evaluate, size=SPHERE_PIXELS)
    psnr, ssim = sphere_likeness(lit, render_sphere(model.evaluate_unmasked, size=SPHERE_PIXELS))
    sampled = {} if errors is None else asdict(errors)
    return Metrics(**sampled, albedo_error=albedo_error, psnr=min(psnr, 200.0), ssim=ssim)
