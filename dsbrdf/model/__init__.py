"""The model: the lobe, its parameters over theta_diff, values, albedo and decomposition."""

from dsbrdf.model.decomposition import Component, Decomposition, decompose
from dsbrdf.model.dsbrdf import DSBRDF

__all__ = ["DSBRDF", "Component", "Decomposition", "decompose"]
