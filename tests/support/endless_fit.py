"""A fit that takes minutes, in each way of asking for it: it does not end while a test looks at it."""

import math
from typing import Any

from dsbrdf import FitOptions

_LOBES = 8  # as many as there may be, of either kind
_KNOTS = range(81)  # one every degree

OPTIONS = FitOptions(n_lobes=_LOBES, ring_lobes=_LOBES - 1, knots=tuple(map(math.radians, _KNOTS)))
ON_THE_WIRE: dict[str, Any] = {
    "method": "global",
    "n_lobes": _LOBES,
    "ring_lobes": _LOBES,
    "knots_deg": [*_KNOTS],
}
FLAGS = ("--n-lobes", str(_LOBES), "--ring-lobes", str(_LOBES), "--knots", ",".join(map(str, _KNOTS)))
