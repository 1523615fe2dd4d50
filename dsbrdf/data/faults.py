"""Notice faults of measurements: clipped highlights, a missing centre, stray light, coarse values, a bad horizon.

Every threshold lies between good measurements, 9 of the RGL database and 62 stand-ins for MERL, and the same
measurements with a fault. Sums over bins of phi_diff tell most faults; `value_findings` needs the samples.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import CENTER_CUTOFF, CHANNELS, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import FIRST_PHI, FoldedProfiles, Profiles, cosine_parts
from dsbrdf.findings import Finding

MIN_CLIPPED_BINS = 40
MIN_CLIPPED_FRACTION = 0.5
"""A highlight is clipped if this fraction of its bins above 90 % of the maximum equals the maximum; good ones: 0.15."""
MAX_CLIPPED_SHARE = 0.7
"""If a larger fraction of all bins equals the maximum, the material is an ideal diffuser, or black, in this channel."""
MIN_HIGHLIGHT_RATIO = 2.0
"""A maximum below this multiple of the median is no highlight."""
MIN_ROUGHNESS = 0.3
"""Limit of the difference of logarithms between bins beyond the cutoff and the mean of their neighbours in theta_diff.

Nine in ten bins must differ by less; good measurements reach 0.23.
"""
MIN_JUMP = 0.8
"""Limit of the difference of logarithms between bins 2 degrees of theta_diff apart, on either side of the cutoff.

Nine in ten bins must differ by less; good measurements reach 0.6.
"""
MISTRUST_POWER = 12.0
"""Weights beyond the cutoff fall with this power of the disagreement, in units of its limit."""
MAX_SINGLE_ROUGHNESS = 1.0
"""A bin beyond the cutoff whose logarithm differs more from its neighbours has less weight than they."""
_DARK_FRACTION = 1e-3  # This fraction of the mean is added before a logarithm, because 0 has none.
_FLOOR_EDGES_HALF = np.sqrt(90.0 * np.array([25.0, 35.0, 45.0, 55.0, 65.0, 75.0])).astype(int)
_FLOOR_EDGES_DIFF = (0, 15, 30, 45, 60, 70)
_FLOOR_COSINE = float(np.cos(np.radians(75.0)))
_MIN_FLOOR_CELLS = 8
_MIN_FLATNESS = 0.93
"""Minimum over cells divided by the median, beyond which there is a floor; good measurements reach 0.91."""
_MAX_FLOOR_COLOUR = 2.0
"""Stray light is about grey: channels whose minimum differs by a larger factor have no common floor."""
_SAMPLED_NODES = 20_000
_MAX_LEVELS = 1024
_MIN_LEVEL_STEP = 0.005
"""Values are coarse if they have few levels, whose steps at the median exceed this fraction of the median."""
_MIN_OUTSIDE_FRACTION = 0.001


def clip_levels(folded: FoldedProfiles) -> Array:
    """Return the value (3, 1, 1, 1) from which bins of a channel are clipped: a maximum of many bins, or infinity."""
    levels = np.full((3, 1, 1, 1), np.inf)
    for channel, (mean, weight) in enumerate(zip(folded.mean, folded.weight, strict=True)):
        level = mean.max() * (1.0 - 1e-9)
        count, near = np.count_nonzero(mean >= level), np.count_nonzero(mean >= 0.9 * level)
        is_clipped = count >= max(MIN_CLIPPED_BINS, MIN_CLIPPED_FRACTION * near)
        if is_clipped and count < MAX_CLIPPED_SHARE * np.count_nonzero(weight):
            levels[channel] = level
    return levels


def horizon_disagreement(folded: FoldedProfiles, horizon_cutoff: float | None) -> tuple[float, Array]:
    """Return how far bins beyond the cutoff disagree with their neighbours, and factors of trust (3, 90, 90, 10).

    The disagreement is in units of its limit. Up to 1, only single bins have a factor below 1, if there are any.
    """
    trust = np.ones(folded.mean.shape)
    if horizon_cutoff is None:
        return 0.0, trust
    total, filled = folded.weight.sum(), folded.weight > 0.0
    level, swing = cosine_parts()
    beyond = level - swing * np.cos(FIRST_PHI) < np.cos(horizon_cutoff) - 1e-12  # one sample of a bin is enough
    dark = _DARK_FRACTION * float(np.sum(folded.weight * folded.mean)) / max(float(total), 1.0)
    logs = np.log(folded.mean + dark + 1e-300)
    apart = np.abs(logs[:, 1:-1] - 0.5 * (logs[:, 2:] + logs[:, :-2]))
    apart[~(filled[:, 1:-1] & filled[:, 2:] & filled[:, :-2] & beyond[1:-1])] = np.nan
    across = np.abs(logs[:, 2:] - logs[:, :-2])[filled[:, 2:] & filled[:, :-2] & (beyond[2:] & ~beyond[:-2])]
    rough = apart[np.isfinite(apart)]
    if not rough.size or not across.size:
        return 0.0, trust
    disagreement = max(float(np.quantile(rough, 0.9)) / MIN_ROUGHNESS, float(np.quantile(across, 0.9)) / MIN_JUMP)
    trust[:, 1:-1] = 1.0 / np.maximum(np.nan_to_num(apart) / MAX_SINGLE_ROUGHNESS, 1.0) ** MISTRUST_POWER
    trust[:, beyond] *= max(disagreement, 1.0) ** -MISTRUST_POWER
    return disagreement, trust


def profile_findings(data: Profiles) -> Iterator[Finding]:
    """Yield what the sums over phi_diff tell of faults of the measurement."""
    folded = data.folded
    clipped = folded.mean >= clip_levels(folded)
    if clipped.any():
        share = float(np.sum(folded.weight * clipped) / max(float(folded.weight.sum()), 1.0))
        value = float(folded.mean[clipped].max())
        names = " and ".join(name for name, of in zip(CHANNELS, clipped, strict=True) if of.any())
        yield Finding(
            "clipped-highlight",
            f"The highlight is clipped: {share:.1%} of the samples equal the largest value in {names}, {value:.3g}/sr. "
            "They count as lower bounds, so that the height and the width of the highlight are guesses. Measure it "
            "again with a shorter exposure.",
            {"fraction": share, "value": value},
        )
    filled = (folded.weight > 0.0).any(axis=(0, 1, 3))
    first = float(THETA_HALF[filled.argmax()])
    if first > CENTER_CUTOFF:
        yield Finding(
            "missing-centre",
            f"There are no valid samples with theta_half below {np.degrees(first):.1f} degrees: the height of a "
            "highlight narrower than this is not determined, and the model may lack its peak. Measure closer to the "
            "mirror direction.",
            {"theta_half_deg": float(np.degrees(first))},
        )
    disagreement, _ = horizon_disagreement(folded, data.horizon_cutoff)
    if disagreement > 1.0:
        angle = np.degrees(data.horizon_cutoff or 0.0)
        yield Finding(
            "bad-horizon",
            f"Samples with a direction further than {angle:.0f} degrees from the normal disagree with their "
            "neighbours: they have hardly any weight, and the model is extrapolated there.",
            {"disagreement": disagreement},
        )
    yield from _floor_finding(folded)


def _floor_finding(folded: FoldedProfiles) -> Iterator[Finding]:
    """Yield a finding if, away from the highlight, values are the same at all theta_half and theta_diff."""
    level, swing = cosine_parts()
    usable = (level - swing * np.cos(FIRST_PHI) > _FLOOR_COSINE) & (folded.weight > 0.0).all(axis=0)
    cells = []
    for rows in pairwise(_FLOOR_EDGES_DIFF):
        for columns in pairwise(_FLOOR_EDGES_HALF.tolist()):
            cell = slice(*rows), slice(*columns)
            if usable[cell].any():
                cells.append(np.median(folded.mean[:, *cell][:, usable[cell]], axis=1))
    if len(cells) < _MIN_FLOOR_CELLS:
        return
    lowest, middle = np.min(cells, axis=0), np.median(cells, axis=0)
    is_grey = lowest.max() < _MAX_FLOOR_COLOUR * lowest.min()
    if is_grey and np.all(lowest > _MIN_FLATNESS * middle) and folded.mean.max() > MIN_HIGHLIGHT_RATIO * middle.max():
        value, spread = float(lowest.mean()), float(np.max(middle / lowest) - 1.0)
        yield Finding(
            "constant-floor",
            f"Away from the highlight the values are {value:.2g}/sr at all theta_half and theta_diff, within "
            f"{max(spread, 0.01):.0%}. Few materials are so even: stray light or a dark current may be in every "
            "sample. Measure a black sample, and subtract it.",
            {"value": value, "spread": spread},
        )


def value_findings(measurement: Measurement) -> Iterator[Finding]:
    """Yield what single samples tell: colours outside of sRGB, and values of few levels."""
    below = [int(np.count_nonzero((channel < 0.0) & measurement.valid)) for channel in measurement.stored]
    share = max(below) / max(int(np.count_nonzero(measurement.valid)), 1)
    if share > _MIN_OUTSIDE_FRACTION:
        yield Finding(
            "outside-gamut",
            f"In {share:.1%} of the samples {CHANNELS[int(np.argmax(below))]} is below 0, as in colours outside of "
            "sRGB; such values count as 0.",
            {"fraction": share},
        )
    nodes = np.flatnonzero(measurement.valid)
    nodes = nodes[:: max(nodes.size // _SAMPLED_NODES, 1)]
    for channel in measurement.stored.reshape(3, -1)[:, nodes] * measurement.scale[:, np.newaxis]:
        channel = channel[channel < channel.max()]  # The level of a clipped highlight is no coarse level.
        levels = np.unique(channel)
        if not 1 < levels.size <= min(_MAX_LEVELS, channel.size // 4):
            continue
        median = float(np.median(channel))
        above = min(int(np.searchsorted(levels, median, side="right")), levels.size - 1)
        step = float(levels[above] - levels[above - 1])
        if step > _MIN_LEVEL_STEP * median:
            yield Finding(
                "coarse-values",
                f"The values have only {levels.size} levels, as of {np.log2(levels.size):.0f} bits: dark values are "
                f"rounded to steps of {step:.2g}/sr, and the median is {median:.2g}/sr. Merge several exposures.",
                {"levels": float(levels.size), "step": step, "median": median},
            )
            return
