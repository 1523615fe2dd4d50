"""Notice faults of measurements in single samples: angles in another order, cosines, copies, and coarse values.

Every threshold lies between good measurements and the same measurements with a fault, as in `dsbrdf.data.faults`.
"""

from collections.abc import Iterator

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import CHANNELS, PHI_DIFF, THETA_DIFF, THETA_HALF, incident_cosines, nodes_above_horizon
from dsbrdf.data.measurement import Measurement
from dsbrdf.findings import Finding

_MIN_MISPLACED_FRACTION = 0.002
"""Angles are misplaced if more nodes lie on the wrong side of the horizon, as those of good measurements never do."""
_MAX_COPIED_FRACTION = 0.5  # Good measurements have at most 0.04.
_MIN_COSINE_RATIO = 0.3  # Smaller logarithms of the ratio of the two cosines tell too little of the values.
_LOWEST_COSINE = 0.1
_COSINE_TOLERANCE = 0.25
_MIN_COSINE_SHARE = 0.6
"""A cosine is noticed if this fraction of the samples has the power 1, within the tolerance; good ones: below 0.3."""
_SAMPLED_NODES = 20_000
_MAX_LEVELS = 1024
_MIN_LEVEL_STEP = 0.005
"""Values are coarse if they have few levels, whose steps at the median exceed this fraction of the median."""
_MIN_OUTSIDE_FRACTION = 0.001


def channel_findings(values: Array) -> Iterator[Finding]:
    """Yield a finding if a channel of the values (3, n) is the same everywhere, and another is not."""
    spread = np.ptp(values, axis=1)
    if spread.max() > 0.0 and (constant := np.flatnonzero(spread == 0.0)).size:
        names = " and ".join(CHANNELS[channel] for channel in constant)
        value = float(values[constant[0], 0])
        yield Finding(
            "constant-channel",
            f"All values of {names} are {value:.3g}/sr, and other channels vary: check the measurement of {names}.",
            {"value": value},
        )


def _layout_finding(stored: Array) -> Iterator[Finding]:
    """Yield a finding if values are missing above the horizon and present below it, as in another order of angles."""
    above, few = nodes_above_horizon(), stored[:, ::3, ::3]
    negative = few < 0.0
    filled = (~negative if negative.any() else few > 0.0).any(axis=0)
    here = above[::3, ::3]
    wrong = float(np.mean(filled != here))
    if wrong < _MIN_MISPLACED_FRACTION:
        return
    layouts = {
        "theta_half descends": above[::-1][::3, ::3],
        "theta_half is evenly spaced": above[np.sqrt(90.0 * np.arange(90)).astype(int)][::3, ::3],
        "theta_diff descends": above[:, ::-1][::3, ::3],
        "theta_half and theta_diff are exchanged": here.swapaxes(0, 1),
        "phi_diff covers 360 degrees": np.tile(here[..., ::2], 2),
    }
    shifts = [(name, axis, by) for axis, name in enumerate(("theta_half", "theta_diff")) for by in range(-5, 6) if by]
    layouts |= {f"{name} is off by {by} nodes": np.roll(above, by, axis)[::3, ::3] for name, axis, by in shifts}
    layouts |= {f"phi_diff begins at {first} degrees": np.roll(here, -first, axis=2) for first in range(1, 180)}
    misfits = {layout: float(np.mean(filled != mask)) for layout, mask in layouts.items()}
    layout = min(misfits, key=misfits.__getitem__)
    if misfits[layout] < wrong / 3.0:
        yield Finding(
            "misplaced-angles",
            f"At {wrong:.1%} of the nodes values are missing above the horizon or present below it, as in a file in "
            f"which {layout}: the model is that of another material. Write the file in the order of the MERL grid.",
            {"fraction": wrong},
        )


def _cosine_finding(stored: Array) -> Iterator[Finding]:
    """Yield a finding if values with light and viewer exchanged, which are equal, have the ratio of their cosines."""
    angles = THETA_HALF[::9, np.newaxis, np.newaxis], THETA_DIFF[::9, np.newaxis], PHI_DIFF[1:90]
    cosines = np.stack(incident_cosines(*angles)).clip(1e-9)
    few, ratio = stored[:, ::9, ::9], np.log(cosines[0] / cosines[1])
    pairs = np.stack(
        [few[..., 1:90], few[..., :90:-1]]
    )  # Symmetric materials are equal at phi_diff and 180 - phi_diff.
    used = (pairs.min(axis=0) > 0.0) & (cosines.min(axis=0) > _LOWEST_COSINE) & (np.abs(ratio) > _MIN_COSINE_RATIO)
    if not used.any():
        return
    powers = np.log(pairs[0][used] / pairs[1][used]) / np.broadcast_to(ratio, used.shape)[used]
    shares = {
        side: float(np.mean(np.abs(powers - by) < _COSINE_TOLERANCE)) for side, by in (("in", 1.0), ("out", -1.0))
    }
    side = max(shares, key=shares.__getitem__)
    if shares[side] > _MIN_COSINE_SHARE:
        yield Finding(
            "times-cosine",
            f"At {shares[side]:.0%} of the angles, values with light and viewer exchanged differ as if each were the "
            f"BRDF times the cosine of theta_{side}, as renderers return it. If so, divide the values by this cosine.",
            {"fraction": shares[side]},
        )


def value_findings(measurement: Measurement) -> Iterator[Finding]:
    """Yield what single samples tell: angles in another order, a cosine, wrong channels, copies, and few levels."""
    yield from _layout_finding(measurement.stored)
    yield from _cosine_finding(measurement.stored)
    nodes = np.flatnonzero(measurement.valid)
    nodes = nodes[:: max(nodes.size // _SAMPLED_NODES, 1)]
    values = np.multiply(measurement.stored.reshape(3, -1)[:, nodes], measurement.scale[:, np.newaxis], order="C")
    yield from channel_findings(values)
    first, second = np.split(measurement.stored[:, 4::9, 4::9], 2, axis=-1)
    varied = (np.abs(np.diff(first)) > 1e-6 * first[..., 1:]) & (first[..., 1:] >= 0.0)  # Less is rounding.
    varied[..., PHI_DIFF.size // 4 - 1] = False  # Symmetric materials are equal at 45 and 135 degrees.
    if varied.any() and (share := float((first == second)[..., 1:][varied].mean())) > _MAX_COPIED_FRACTION:
        yield Finding(
            "repeated-samples",
            f"At {share:.0%} of the angles the values at phi_diff and at phi_diff + 90 degrees are exactly equal: one "
            "half of the measurement seems to be a copy of the other.",
            {"fraction": share},
        )
    below = (values < 0.0).mean(axis=1)
    share = float(below.max())
    if share > _MIN_OUTSIDE_FRACTION:
        channel = int(np.argmax(below))
        negative = values[channel][values[channel] < 0.0]
        equal = np.ptp(negative) == 0.0
        reason = (
            f"always {negative[0]:.3g}/sr, as where it was not measured" if equal else "as in colours outside of sRGB"
        )
        yield Finding(
            "outside-gamut",
            f"In {share:.1%} of the samples {CHANNELS[channel]} is below 0, {reason}; such values count as 0.",
            {"fraction": share},
        )
    yield from _level_finding(values)


def _level_finding(values: Array) -> Iterator[Finding]:
    """Yield a finding if the values (3, n) of a channel have few levels, whose steps are coarse."""
    for channel in values:
        levels = np.unique(channel[: 2 * _MAX_LEVELS])
        levels = np.unique(channel) if levels.size <= _MAX_LEVELS else levels
        if not 1 < levels.size <= min(_MAX_LEVELS, channel.size // 4):
            continue
        median = float(np.median(channel))
        above = min(int(np.searchsorted(levels, median, side="right")), levels.size - 1)
        step = float(levels[above] - levels[above - 1])
        if step > _MIN_LEVEL_STEP * median:
            yield Finding(
                "coarse-values",
                f"The values have only {levels.size} levels, about {np.log2(levels.size):.0f} bits: dark values are "
                f"rounded to steps of {step:.2g}/sr, and the median is {median:.2g}/sr. Merge several exposures.",
                {"levels": float(levels.size), "step": step, "median": median},
            )
            return
