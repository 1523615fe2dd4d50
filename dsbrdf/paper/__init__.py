"""The method of the paper: Algorithm 1 on slices, and the choice of the number of lobes by Williams' test."""

from dsbrdf.paper.paper_method import PAPER_SLICES, WilliamsRow, fit_slicewise, williams_critical_value, williams_test

__all__ = [
    "PAPER_SLICES",
    "WilliamsRow",
    "fit_slicewise",
    "williams_critical_value",
    "williams_test",
]
