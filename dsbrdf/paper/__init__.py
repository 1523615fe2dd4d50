"""The method of the paper: Algorithm 1 on slices, and the choice of the number of lobes by Williams' test."""

from dsbrdf.paper.lobe_selection import WilliamsRow, williams_critical_value, williams_test
from dsbrdf.paper.paper_method import PAPER_SLICES, fit_slicewise

__all__ = [
    "PAPER_SLICES",
    "WilliamsRow",
    "fit_slicewise",
    "williams_critical_value",
    "williams_test",
]
