"""Write warnings about a fitted model, one sentence each.

The limits were chosen on 70 reference materials, 8 of the RGL database and 62 stand-ins for MERL, so that only the
material with the worst fit exceeds a limit. The comment on each limit has the largest value of all other materials.
"""

from collections.abc import Iterator

import numpy as np

from dsbrdf.data.geometry import CHANNELS, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.report import DirectionalAlbedo, KnotReport
from dsbrdf.samples.scattered_samples import ScatteredSamples

_COMPLETE_ANGLE = np.radians(85.0)
"""If data end at a larger angle, only a thin rim of a rendered sphere is extrapolated, so there is no warning.

The data of all reference materials reach 88 degrees.
"""
_MAX_ALBEDO = 1.0 + 5e-4
"""A smaller albedo would be printed as 1.000, so there is no warning; the reference materials reach 0.93."""
_MAX_RELATIVE_ASYMMETRY = 0.15
"""Noise of 20 % on each sample causes this relative difference between samples that are equal by symmetry.

The reference materials have differences up to 0.11.
"""
_MAX_ALBEDO_ERROR = 0.15
"""Errors of diffuse reflection change the albedo, but hardly relative_rms, so the albedo has a limit of its own.

The reference materials have relative errors of the albedo up to 0.06.
"""
_MAX_RELATIVE_MISFIT = 0.1
"""Limit of the relative error of a fit, without the part that noise explains.

The reference material chm_mint has 0.15, and all others have up to 0.05.
"""


def fit_warnings(
    data: Profiles,
    knots: KnotReport,
    albedo: DirectionalAlbedo,
    *,
    in_slices: bool = False,
    is_unit_wrong: bool = False,
) -> Iterator[str]:
    """Yield warnings about the convergence of a fit, missing data and a too large albedo.

    If `is_unit_wrong`, `dsbrdf.samples.doubts` has already warned about the unit, and there is no warning about the
    albedo. Warnings about components are in `dsbrdf.components.component`.
    """
    if not np.all(knots.converged):
        yield convergence_sentence(knots, in_slices=in_slices)
    valid = np.any(data.folded.weight > 0.0, axis=(0, 3))
    ends = {"theta_diff": THETA_DIFF[valid.any(axis=1)].max(), "theta_half": THETA_HALF[valid.any(axis=0)].max()}
    for name, last in ends.items():
        if last < _COMPLETE_ANGLE:
            yield (
                f"The measurement has no valid samples beyond {name} = {np.degrees(last):.0f} degrees: the model is "
                "extrapolated there."
            )
    values = np.array(albedo.rgb)
    row, channel = np.unravel_index(values.argmax(), values.shape)
    if values[row, channel] > _MAX_ALBEDO and not is_unit_wrong:
        yield (
            f"The model reflects more light than it receives: its directional albedo is {values[row, channel]:.3f} at "
            f"{np.degrees(albedo.theta_out[row]):.0f} degrees in the {CHANNELS[channel]} channel, so that rendered "
            "images can become too bright."
        )


def convergence_sentence(knots: KnotReport, *, in_slices: bool) -> str:
    """Return the warning about a fit, or some of its slices, that stopped before convergence."""
    stopped = np.logical_not(knots.converged)
    bound, count = np.array(knots.iterations)[stopped].max(), np.count_nonzero(stopped)
    several = in_slices and count > 1
    what = f"{count} {'slices' if several else 'slice'}" if in_slices else "The fit"
    return (
        f"{what} stopped at the bound of {bound} iterations before {'they' if several else 'it'} converged: "
        "the model may be less accurate than it could be."
    )


def accuracy_warnings(metrics: Metrics) -> Iterator[str]:
    """Yield warnings about large errors of a fit; none if the metrics are None."""
    error, floor, albedo_error = metrics.relative_rms, metrics.symmetric_floor, metrics.albedo_error
    if error is None or floor is None or albedo_error is None:
        return
    if floor > _MAX_RELATIVE_ASYMMETRY:
        yield (
            f"At phi_diff, -phi_diff and 180 degrees - phi_diff the samples differ by {floor:.1%}, but a reciprocal "
            "isotropic material has equal values there. The measurement is noisy, or the material sparkles or is "
            "anisotropic; no model of this kind can be more accurate."
        )
    # Noise alone causes a relative_rms of sqrt(2) times the floor, because the floor belongs to means of two samples.
    misfit = np.sqrt(max(error**2 - 2.0 * floor**2, 0.0))
    if misfit > _MAX_RELATIVE_MISFIT:
        yield (
            f"The error of the fit is {error:.1%}, but the best reciprocal isotropic model would have {floor:.1%}: "
            "the lobes do not follow the measurement. Compare pictures of both before you use the model."
        )
    if albedo_error > _MAX_ALBEDO_ERROR:
        yield (
            f"The model reflects {albedo_error:.1%} more or less light than the measurement, on average over angles "
            "and channels: rendered pictures will be too bright or too dark."
        )


MAX_EXPECTED_ERROR = 0.1
"""If the expected error over all directions is larger, a report lists directions to measure next."""
_MIN_OUT_OF_PLANE_SINE = 0.02
"""If the triple product of the normal and both directions is smaller at all samples, they lie in one plane."""
_MAX_SAMPLE_MISFIT = 0.3
_REPORTED_ERROR_RATIO = 2.0
"""The error at held-out samples is reported if it is at least this multiple of the error at the fitted samples."""
_MIN_REPORTED_ERROR = 0.05
"""A smaller error at held-out samples is not reported."""


def sample_warnings(samples: ScatteredSamples, metrics: Metrics, structure: str, few: int) -> Iterator[str]:
    """Yield warnings about the accuracy of a fit of samples; `structure` names the material's most probable layers."""
    here, left_out, expected = metrics.relative_rms, metrics.relative_rms_left_out, metrics.relative_rms_expected
    if here is None or left_out is None or expected is None:
        return
    if len(samples.values) < few:
        yield (
            f"There are only {len(samples.values)} samples. The model consists of physical layers ({structure}), "
            "corrected near the samples. Measure more directions for a more accurate model."
        )
    first, second = samples.omega_in, samples.omega_out
    if np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).max() < _MIN_OUT_OF_PLANE_SINE:
        yield (
            "All samples lie in one plane of incidence. Outside of this plane the brightness of highlights is a guess "
            "from other materials and can be wrong several times over: measure directions there as well."
        )
    if here > _MAX_SAMPLE_MISFIT:
        yield (
            f"The model misses the samples by {here:.0%} of their size. Check the table for values that are no "
            "measurements, for a wrong unit of the angles, and for a mirror direction on the wrong side."
        )
    if left_out >= max(_REPORTED_ERROR_RATIO * here, _MIN_REPORTED_ERROR):
        yield (
            f"The error (relative_rms) is {here:.3g} at the samples of the fit, but {left_out:.3g} at samples held out "
            "of a fit: expect the larger error between the samples."
        )
    if expected > MAX_EXPECTED_ERROR:
        yield (
            f"Over all directions the error is probably below {expected:.0%}: the model is a guess where there are no "
            "samples. measure_next lists the directions whose measurement would help most."
        )
