"""The longest fit that options can ask for, in each way of asking: it does not end while a test looks at it."""

from typing import Any

from dsbrdf import FitOptions

# These are the largest numbers that a fit may have.
_LOBES = 10
_RINGS = 9
_KNOTS = tuple(range(90))  # one every degree

OPTIONS = FitOptions(n_lobes=_LOBES, ring_lobes=_RINGS, knots_deg=_KNOTS, robust=True, lobe="student")
ON_THE_WIRE: dict[str, Any] = {
    "method": "global",
    "n_lobes": _LOBES,
    "ring_lobes": _RINGS,
    "knots_deg": [*_KNOTS],
    "robust": True,
    "lobe": "student",
}
FLAGS = (
    *("--n-lobes", str(_LOBES), "--ring-lobes", str(_RINGS), "--knots-deg", ",".join(map(str, _KNOTS))),
    *("--robust", "--lobe", "student"),
)
