"""Keep the result of a fit, the model and its report, and find what a user should know before using it.

Python, the command line, HTTP, the page and notebooks all show `FitReport.findings`. A report consists of frozen
dataclasses, tuples and numbers, so that reports can be compared, hashed and pickled.

The limits were chosen on 71 reference materials, 9 of the RGL database and 62 stand-ins for MERL, so that only the
materials with the worst fits exceed a limit. The comment on each limit has the largest value of all other materials.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.components.decomposition import decompose
from dsbrdf.data.geometry import CHANNELS, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.findings import Finding
from dsbrdf.fitting.lobe_search import SearchStep
from dsbrdf.fitting.metrics import BandErrors, ChannelErrors, Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import DirectionalAlbedo, KnotReport, LeftOutErrors, SelectionStep, SuggestedPair
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.version import Versions

_COMPLETE_ANGLE = np.radians(85.0)
"""If data end at a larger angle, only a thin rim of a rendered sphere is extrapolated, so there is no warning.

The data of all reference materials reach 88 degrees.
"""
_MAX_ALBEDO = 1.0 + 5e-4
"""A smaller albedo would be printed as 1.000, so there is no warning; the reference materials reach 0.93."""
_MIN_ALBEDO = 1e-3
"""A material that reflects less at every angle is probably in a wrong unit; black velvet reflects 0.004."""
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

The reference materials chm_mint and cg_sunflower have 0.15 and 0.17, and all others have up to 0.05.
"""


MAX_EXPECTED_ERROR = 0.1
"""If the expected error over all directions is larger, a report lists directions to measure next."""
_MIN_OUT_OF_PLANE_SINE = 0.02
"""If the triple product of the normal and both directions is smaller at all samples, they lie in one plane."""
_MAX_SAMPLE_MISFIT = 0.3
_REPORTED_ERROR_RATIO = 2.0
"""The error at held-out samples is reported if it is at least this multiple of the error at the fitted samples."""
_MIN_REPORTED_ERROR = 0.05
"""A smaller error at held-out samples is not reported."""
VERY_CLOSE_DB = 38.0
CLOSE_DB = 32.0
_VERDICTS_BY_PSNR = (
    (45.0, "hard to tell apart"),
    (VERY_CLOSE_DB, "very close"),
    (CLOSE_DB, "close"),
    (26.0, "visibly different"),
)
"""The verdict on a fit is the first in this table whose PSNR [dB] the lit sphere of the fit reaches."""


@dataclass(frozen=True, repr=False)
class FitReport:
    """Report the course and the errors of a fit.

    Attributes
    ----------
    findings_of_fit : tuple of Finding
        Findings about the measurement and the fit; `findings` adds those about the components.
    metrics : Metrics
        Metrics of the fit; all are None if only profiles were fitted.
    by_channel, by_theta_diff : tuple of ChannelErrors, tuple of BandErrors
        Errors of each channel that is not black, and of each band of theta_diff with data; empty without metrics.
    knots : KnotReport
        How the fit went at each knot of theta_diff.
    search, selection : tuple of SearchStep, tuple of SelectionStep
        Mixtures of lobes that the method "global" tried; numbers of lobes that the method "paper" compared.
    directional_albedo, n_numbers : DirectionalAlbedo, int
        Fraction of the light that the model reflects, and how many numbers the model stores.
    timings : dict of str to float
        Time of each step, by its name [s].
    options, versions : FitOptions, Versions
        Options of the fit, and versions of the algorithm, this library and the packages that it computes with.
    left_out, measure_next : tuple of LeftOutErrors, tuple of SuggestedPair
        For scattered samples only: errors at samples that were left out, and directions to measure next, the most
        useful pair first. There are no pairs unless the error expected over all directions is large.
    samples : str or None
        Digest of the scattered samples, see `dsbrdf.ScatteredSamples`; None for a measurement on a grid.
    """

    findings_of_fit: tuple[Finding, ...]
    metrics: Metrics
    by_channel: tuple[ChannelErrors, ...]
    by_theta_diff: tuple[BandErrors, ...]
    knots: KnotReport
    search: tuple[SearchStep, ...]
    selection: tuple[SelectionStep, ...]
    directional_albedo: DirectionalAlbedo
    n_numbers: int
    timings: dict[str, float] = field(hash=False)
    options: FitOptions
    versions: Versions
    left_out: tuple[LeftOutErrors, ...] = ()
    measure_next: tuple[SuggestedPair, ...] = ()
    samples: str | None = None
    _model: ClassVar[DSBRDF | None] = None  # An instance has the model of the `FitResult` that it belongs to.

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All that a user should know before using the model, by code, sentence and numbers.

        The findings about the components need `dsbrdf.decompose`, which takes 0.1 s when they are first asked for.
        """
        return self.findings_of_fit + (() if self._model is None else decompose(FitResult(self._model, self)).findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentences of the `findings`."""
        return tuple(finding.sentence for finding in self.findings)

    def __repr__(self) -> str:
        error = self.metrics.relative_rms
        accuracy = "no metrics" if error is None else f"relative_rms {error:.4g}"
        return f"<FitReport: {accuracy}, {self.n_numbers} numbers>"

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain dicts, lists, texts and numbers, keyed by the names of its attributes."""
        content: dict[str, Any] = _plain(asdict(self))
        return content


@dataclass(frozen=True)
class FitResult:
    """A model and the report of its fit.

    A result can be drawn, decomposed, saved and evaluated like its model, as in `dsbrdf.render_sphere(result)`.

    Attributes
    ----------
    model : DSBRDF
    report : FitReport
    """

    model: DSBRDF
    report: FitReport

    def __post_init__(self) -> None:
        bound = replace(self.report)  # The report of another result may be the same object.
        object.__setattr__(bound, "_model", self.model)
        object.__setattr__(self, "report", bound)

    @property
    def is_clipped(self) -> bool:
        """Whether the highlight of the measurement is clipped, so that its height and width are guesses."""
        return any(finding.code == "clipped-highlight" for finding in self.report.findings_of_fit)

    def evaluate(self, theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike = np.pi / 2) -> Array:
        """Return RGB values of the model, shape (..., 3) [1/sr], at angles [rad]; see `DSBRDF.evaluate`."""
        return self.model.evaluate(theta_half, theta_diff, phi_diff)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def fit_findings(
    data: Profiles,
    knots: KnotReport,
    albedo: DirectionalAlbedo,
    *,
    in_slices: bool = False,
    is_unit_wrong: bool = False,
) -> Iterator[Finding]:
    """Yield findings about the convergence of a fit, missing data, and an albedo too large or too small.

    If `is_unit_wrong`, `dsbrdf.samples.doubts` has already found the unit wrong, and the albedo says nothing.
    """
    if not np.all(knots.converged):
        yield convergence_finding(knots, in_slices=in_slices)
    valid = np.any(data.folded.weight > 0.0, axis=(0, 3))
    ends = {"theta_diff": THETA_DIFF[valid.any(axis=1)].max(), "theta_half": THETA_HALF[valid.any(axis=0)].max()}
    for name, last in ends.items():
        if last < _COMPLETE_ANGLE:
            angle = float(np.degrees(last))
            yield Finding(
                "incomplete",
                f"The measurement has no valid samples beyond {name} = {angle:.0f} degrees: the model is extrapolated "
                "there.",
                {f"{name}_deg": angle},
            )
    values = np.array(albedo.rgb)
    row, channel = np.unravel_index(values.argmax(), values.shape)
    largest, angle = float(values[row, channel]), float(np.degrees(albedo.theta_out[row]))
    if largest > _MAX_ALBEDO and not is_unit_wrong:
        yield Finding(
            "albedo-above-1",
            f"The model reflects more light than it receives: its directional albedo is {largest:.3f} at {angle:.0f} "
            f"degrees in the {CHANNELS[channel]} channel, so that rendered images can become too bright.",
            {"albedo": largest, "theta_out_deg": angle},
        )
    if largest < _MIN_ALBEDO:
        yield Finding(
            "albedo-near-0",
            f"The model reflects at most {largest:.2g} of the light, less than black velvet, which reflects 0.004: "
            "check the unit of the values.",
            {"albedo": largest},
        )


def convergence_finding(knots: KnotReport, *, in_slices: bool) -> Finding:
    """Return the finding about a fit, or some of its slices, that stopped before convergence."""
    stopped = np.logical_not(knots.converged)
    bound, count = int(np.array(knots.iterations)[stopped].max()), int(np.count_nonzero(stopped))
    several = in_slices and count > 1
    what = f"{count} {'slices' if several else 'slice'}" if in_slices else "The fit"
    return Finding(
        "not-converged",
        f"{what} stopped after {bound} iterations, before {'they' if several else 'it'} converged: "
        "the model may be less accurate than it could be.",
        {"iterations": float(bound)},
    )


def accuracy_findings(metrics: Metrics, *, is_clipped: bool = False) -> Iterator[Finding]:
    """Yield findings about large errors of a fit; none if the metrics are None.

    The metrics compare with the values of a clipped highlight, which the fit exceeds rightly.
    """
    error, floor, albedo_error = metrics.relative_rms, metrics.symmetric_floor, metrics.albedo_error
    if error is None or floor is None or albedo_error is None:
        return
    if floor > _MAX_RELATIVE_ASYMMETRY:
        yield Finding(
            "asymmetric",
            f"At phi_diff, -phi_diff and 180 degrees - phi_diff the samples differ by {floor:.1%}, but a reciprocal "
            "isotropic material has equal values there. The measurement is noisy, or the material sparkles or is "
            "anisotropic; no model of this kind can be more accurate.",
            {"symmetric_floor": floor},
        )
    if misses_highlight(metrics) and not is_clipped:
        possible = "below 0.1%" if floor < 1e-3 else f"{floor:.1%}"
        look = "A lit sphere hardly shows it" if (metrics.psnr or 0.0) >= VERY_CLOSE_DB else "A lit sphere shows it"
        yield Finding(
            "missed-highlight",
            f"The brightest values of the fit have an error of {error:.1%} (relative_rms), where a model of this kind "
            f"could reach {possible}: the lobes do not follow the highlight. {look}; compare pictures of both.",
            {"relative_rms": error, "symmetric_floor": floor},
        )
    if albedo_error > _MAX_ALBEDO_ERROR and not is_clipped:
        yield Finding(
            "wrong-brightness",
            f"The model reflects {albedo_error:.1%} more or less light than the measurement, on average over angles "
            "and channels: rendered pictures will be too bright or too dark.",
            {"albedo_error": albedo_error},
        )


def misses_highlight(metrics: Metrics) -> bool:
    """Tell whether the error of a fit is large even without the part that noise explains."""
    error, floor = metrics.relative_rms or 0.0, metrics.symmetric_floor or 0.0
    # Noise alone causes a relative_rms of sqrt(2) times the floor, because the floor belongs to means of two samples.
    return error**2 - 2.0 * floor**2 > _MAX_RELATIVE_MISFIT**2


def verdict(metrics: Metrics) -> str | None:
    """Return in words how alike measurement and fit are, from all metrics; None without a lit sphere."""
    if metrics.psnr is None:
        return None
    words = next((words for least, words in _VERDICTS_BY_PSNR if metrics.psnr >= least), "strongly different")
    if metrics.psnr < CLOSE_DB or not misses_highlight(metrics):
        return f"{words} ({metrics.psnr:.1f} dB)"
    return f"{words} in pictures ({metrics.psnr:.1f} dB), but its highlight is off by {metrics.relative_rms:.0%}"


def sample_findings(samples: ScatteredSamples, metrics: Metrics, structure: str, few: int) -> Iterator[Finding]:
    """Yield findings about the accuracy of a fit of samples; `structure` names the material's most probable layers."""
    here, left_out, expected = metrics.relative_rms, metrics.relative_rms_left_out, metrics.relative_rms_expected
    if here is None or left_out is None or expected is None:
        return
    yield from _coverage_findings(samples, structure, few)
    floor = metrics.symmetric_floor or 0.0
    if floor > _MAX_RELATIVE_ASYMMETRY:
        yield Finding(
            "asymmetric",
            f"Samples that are equal in a reciprocal isotropic material differ by {floor:.0%}: repeated ones, or those "
            "with light and viewer exchanged or the material turned. The measurement is noisy or misaligned, or the "
            "material sparkles or is anisotropic; no model of this kind can be more accurate.",
            {"symmetric_floor": floor},
        )
    if here**2 - floor**2 > _MAX_SAMPLE_MISFIT**2:
        yield Finding(
            "missed-samples",
            f"The model misses the samples by {here:.0%} of their size. Check the table for values that are no "
            "measurements, for a wrong unit of the angles, and for a mirror direction on the wrong side.",
            {"relative_rms": here},
        )
    if left_out >= max(_REPORTED_ERROR_RATIO * here, _MIN_REPORTED_ERROR):
        yield Finding(
            "error-between-samples",
            f"The error (relative_rms) is {here:.3g} at the samples of the fit, but {left_out:.3g} at samples held out "
            "of a fit: expect the larger error between the samples.",
            {"relative_rms": here, "relative_rms_left_out": left_out},
        )
    if expected > MAX_EXPECTED_ERROR:
        yield Finding(
            "guess-elsewhere",
            f"Over all directions the error is probably below {expected:.0%}: the model is a guess where there are no "
            "samples. measure_next lists the directions whose measurement would help most.",
            {"relative_rms_expected": expected},
        )


def _coverage_findings(samples: ScatteredSamples, structure: str, few: int) -> Iterator[Finding]:
    """Yield findings about samples that are fewer than `few`, or all in one plane of incidence."""
    count = len(samples.values)
    if count < few:
        yield Finding(
            "few-samples",
            f"There are only {count} samples. The model consists of physical layers ({structure}), corrected near the "
            "samples. Measure more directions for a more accurate model.",
            {"samples": float(count)},
        )
    first, second = samples.omega_in, samples.omega_out
    if np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).max() < _MIN_OUT_OF_PLANE_SINE:
        yield Finding(
            "one-plane",
            "All samples lie in one plane of incidence. Outside of this plane the brightness of highlights is a guess "
            "from other materials, and can be wrong by a factor of several: measure directions there as well.",
        )
