"""The method of the paper: Algorithm 1 on slices, and the choice of the number of lobes by Williams' test."""

from dsbrdf.paper.paper_method import PAPER_SLICES as PAPER_SLICES
from dsbrdf.paper.paper_method import WilliamsRow as WilliamsRow
from dsbrdf.paper.paper_method import fit_slicewise as fit_slicewise
from dsbrdf.paper.paper_method import williams_critical_value as williams_critical_value
from dsbrdf.paper.paper_method import williams_test as williams_test
