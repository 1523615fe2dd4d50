"""Notice faults of measurements in sums over bins of phi_diff: clipped highlights, a missing centre, stray light.

Every threshold lies between good measurements, 9 of the RGL database and 62 stand-ins for MERL, and the same
measurements with a fault. The module `dsbrdf.data.value_faults` notices faults that only the samples tell.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.ndimage import binary_dilation

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import CENTER_CUTOFF, CHANNELS, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import FIRST_PHI, FoldedProfiles, Profiles, cosine_parts
from dsbrdf.findings import Finding

MIN_CLIPPED_BINS = 40
MIN_CLIPPED_FRACTION = 0.5
"""A highlight is clipped if this fraction of its bins above 90 % of the maximum equals the maximum; good ones: 0.15."""
MAX_CLIPPED_FRACTION = 0.7
"""If a larger fraction of all bins equals the maximum, the material is an ideal diffuser, or black, in this channel."""
MIN_HIGHLIGHT_RATIO = 2.0
"""A maximum below this multiple of the median is no highlight."""
_MIN_PLATEAU_RATIO = 20.0
"""A highlight is flat if bins above 93 % of its maximum outnumber those at 86 to 93 % by this factor.

The reference materials reach a factor of 10.
"""
_OUTLYING_BINS = 20  # The maximum of a noisy highlight is the largest value but for these.
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
_FLOOR_COSINE = float(np.cos(np.radians(75.0)))
_MIN_FLOOR_CELLS = 8
_MIN_FLATNESS = 0.92
"""Minimum over cells divided by the median, beyond which there is a floor; good grey measurements reach 0.90."""
_MAX_FLOOR_COLOUR = 1.1
"""Channels whose minimum differs by a larger factor have no common floor; known even materials differ by more."""
_MIN_BINS_IN_SWEEP = 40
_MAX_JUMP = 0.06
"""Limit of the third difference of logarithms over theta_diff that all theta_half share; good measurements reach 0.04.

A step of the logarithm has a third difference of its own height, a single high row one of 1.5 times its height, and
the slope and the curvature of a material have none.
"""
_BRIGHT_FRACTION = 0.3  # Values above this fraction of the median, or of a highlight's maximum, are bright.
_MIN_EDGE_FRACTION = 0.0025
"""Zeros are missing values if this fraction of the bins is 0 beside a bright bin; good measurements reach 0.0016."""
_MIN_CERTAINTY = 5.0  # A jump must exceed its standard error by this factor.
_MIN_HOLLOW_FRACTION = 0.02
"""A highlight is hollow if its values double outwards at this fraction of (theta_diff, phi_diff); good ones: 0."""
_MAX_REPEATED = 0.2
"""Limit of the fraction of bins that equal the bin before, and not the one before that."""


def clip_levels(folded: FoldedProfiles) -> Array:
    """Return the value (3, 1, 1, 1) from which bins of a channel are clipped: a maximum of many bins, or infinity."""
    levels = np.full((3, 1, 1, 1), np.inf)
    for channel, (mean, weight) in enumerate(zip(folded.mean, folded.weight, strict=True)):
        level = mean.max() * (1.0 - 1e-9)
        count, near = np.count_nonzero(mean >= level), np.count_nonzero(mean >= 0.9 * level)
        is_clipped = count >= max(MIN_CLIPPED_BINS, MIN_CLIPPED_FRACTION * near)
        if is_clipped and count < MAX_CLIPPED_FRACTION * np.count_nonzero(weight):
            levels[channel] = level
    return levels


def horizon_disagreement(folded: FoldedProfiles, horizon_cutoff: float | None) -> tuple[float, Array]:
    """Return how far bins beyond the cutoff disagree with their neighbours, and factors of trust (3, 90, 90, 10).

    The disagreement is in units of its limit. Up to 1, only single bins have a factor below 1, if there are any.
    """
    trust = np.ones(folded.mean.shape)
    if horizon_cutoff is None:
        return 0.0, trust
    level, swing = cosine_parts()
    beyond = level - swing * np.cos(FIRST_PHI) < np.cos(horizon_cutoff) - 1e-12  # One sample of a bin is enough.
    dark = _DARK_FRACTION * float(np.vdot(folded.weight, folded.mean)) / max(float(folded.weight.sum()), 1.0)
    logs = np.where(folded.weight > 0.0, np.log(folded.mean + dark + 1e-300), np.nan)
    here, before, after = slice(1, -1), slice(None, -2), slice(2, None)
    apart = np.where(beyond[here], np.abs(logs[:, here] - 0.5 * (logs[:, after] + logs[:, before])), np.nan)
    across = np.abs(logs[:, after] - logs[:, before])[:, beyond[after] & ~beyond[before]]
    if np.isnan(apart).all() or np.isnan(across).all():
        return 0.0, trust
    disagreement = max(_ninth_decile(apart) / MIN_ROUGHNESS, _ninth_decile(across) / MIN_JUMP)
    single = apart > MAX_SINGLE_ROUGHNESS
    trust[:, here][single] = (apart[single] / MAX_SINGLE_ROUGHNESS) ** -MISTRUST_POWER
    if disagreement > 1.0:
        trust[:, beyond] *= disagreement**-MISTRUST_POWER
    return disagreement, trust


def _ninth_decile(differences: Array) -> float:
    found = differences[np.isfinite(differences)]
    return float(np.partition(found, 9 * found.size // 10)[9 * found.size // 10])


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
    else:
        yield from _plateau_finding(folded)
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
    level, swing = cosine_parts()
    usable = (level - swing * np.cos(FIRST_PHI) > _FLOOR_COSINE) & (folded.weight > 0.0).all(axis=0)
    yield from _floor_finding(folded, usable)
    yield from _dark_findings(folded, usable)
    yield from _sweep_findings(folded, usable)


def _plateau_finding(folded: FoldedProfiles) -> Iterator[Finding]:
    """Yield a finding if the top of a highlight is flat, as if noise or a correction followed the clipping."""
    names = list[str]()
    for channel, mean, weight in zip(CHANNELS, folded.mean, folded.weight, strict=True):
        values = mean[weight > 0.0]
        if values.size < MIN_CLIPPED_BINS:
            continue
        largest = float(np.partition(values, -_OUTLYING_BINS)[-_OUTLYING_BINS])
        above, below = (int(np.count_nonzero(values >= fraction * largest)) for fraction in (0.93, 0.86))
        is_flat = above >= MIN_CLIPPED_BINS and above > _MIN_PLATEAU_RATIO * (below - above + 3)
        if is_flat and largest > MIN_HIGHLIGHT_RATIO * np.median(values):
            names.append(channel)
    if names:
        yield Finding(
            "clipped-highlight",
            f"The highlight seems to be clipped: its top is flat in {' and '.join(names)}, with an edge. If it is, the "
            "height and the width of the fitted highlight are wrong. Measure it again with a shorter exposure.",
        )


def _floor_finding(folded: FoldedProfiles, usable: Mask) -> Iterator[Finding]:
    """Yield a finding if, away from the highlight, values are the same at all theta_half and theta_diff."""
    # The cells lie between 24 and 75 degrees of theta_half, and below 75 degrees of theta_diff.
    blocks = [np.s_[row : row + 15, column : column + 7] for row, column in product(range(0, 75, 15), range(47, 82, 7))]
    cells = [np.median(folded.mean[:, *one][:, usable[one]], axis=1) for one in blocks if usable[one].any()]
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
            "sample. Measure a black sample, and subtract its values.",
            {"value": value, "spread": spread},
        )


def _dark_findings(folded: FoldedProfiles, usable: Mask) -> Iterator[Finding]:
    """Yield findings if values are 0 beside bright ones, or if a highlight falls suddenly towards its centre."""
    filled = (folded.weight > 0.0).all(axis=0)
    # The mean of the channels is positive where only one of them is outside of sRGB and counts as 0.
    mean = np.where(filled, folded.mean.mean(axis=0), 0.0)
    zero, bright = filled & (mean == 0.0), mean > _BRIGHT_FRACTION * np.median(mean[mean > 0.0])
    edge = zero & binary_dilation(bright) if zero.any() else zero
    if np.count_nonzero(edge) > _MIN_EDGE_FRACTION * np.count_nonzero(filled):
        share = float(folded.weight[:, zero].sum() / folded.weight.sum())
        yield Finding(
            "sudden-zeros",
            f"{share:.1%} of the samples are 0 in all channels, right beside bright ones: the fit takes "
            "them for black. Write -1 where nothing was measured, and keep the digits of dark values.",
            {"fraction": share},
        )
    mean, usable = mean[..., :-1], usable[..., :-1]  # The last bin has a single sample, which may be noise.
    inner, outer, top = mean[:, :-1], mean[:, 1:], mean.max(axis=1, keepdims=True)
    falls = (outer > 2.0 * inner) & (inner > 0.0) & (outer > _BRIGHT_FRACTION * top) & usable[:, :-1]
    share = np.count_nonzero(falls.any(axis=1)) / max(int(np.count_nonzero(usable.any(axis=1))), 1)
    if share > _MIN_HOLLOW_FRACTION:
        angle = float(np.degrees(THETA_HALF[1:][falls.any(axis=(0, 2))].max()))
        yield Finding(
            "hollow-highlight",
            f"Within {angle:.1f} degrees of theta_half, the highlight falls suddenly by more than half towards its "
            f"centre, at {share:.0%} of the other angles: a counter may have overflowed. Measure it again with a "
            "shorter exposure.",
            {"fraction": share, "theta_half_deg": angle},
        )


def _sweep_findings(folded: FoldedProfiles, usable: Mask) -> Iterator[Finding]:
    """Yield findings if the values jump from one theta_diff to the next, or if a theta_half repeats another."""
    mean = folded.mean[:, :, ::2, ::3]  # a sixth of the bins is enough
    logs = np.where(usable[:, ::2, ::3] & (mean > 0.0), np.log(np.maximum(mean, 1e-300)), np.nan)
    steps = 1.5 * (logs[:, 2:-1] - logs[:, 1:-2]) - 0.5 * (logs[:, 3:] - logs[:, :-3])
    steps = steps.reshape(3, THETA_DIFF.size - 3, -1)
    filled = np.count_nonzero(np.isfinite(steps), axis=2).min(axis=0) >= _MIN_BINS_IN_SWEEP
    steps = steps[:, filled] if filled.any() else np.zeros((3, 1, 1))
    jumps = np.abs(np.nanmedian(steps, axis=2))
    channel, row = np.unravel_index(jumps.argmax(), jumps.shape)
    jump, found = float(jumps.max()), steps[channel, row][np.isfinite(steps[channel, row])]
    error = 1.25 * float(found.std()) / np.sqrt(found.size)
    if jump > max(_MAX_JUMP, _MIN_CERTAINTY * error):
        angle = float(np.degrees(THETA_DIFF[2:-1][filled][row]))
        yield Finding(
            "uneven-sweeps",
            f"At theta_diff = {angle:.0f} degrees values jump by {np.expm1(jump / 1.5):.0%} to {np.expm1(jump):.0%}. "
            "The lamp may have drifted between sweeps, or channels were exchanged. Scale the sweeps to each other.",
            {"jump": float(np.expm1(jump)), "theta_diff_deg": angle},
        )
    same = folded.mean[:, :, 1:] == folded.mean[:, :, :-1]
    repeated = float(np.count_nonzero(same[:, :, 1:] & ~same[:, :, :-1] & usable[:, 2:]))
    if (share := repeated / max(3 * int(np.count_nonzero(usable[:, 2:])), 1)) > _MAX_REPEATED:
        yield Finding(
            "repeated-samples",
            f"At {share:.0%} of the angles the values are exactly those at the next smaller theta_half: samples seem "
            "to be repeated, and the measurement has fewer angles than its file.",
            {"fraction": share},
        )
