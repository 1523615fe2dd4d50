"""Decompose a reflectance into components by fitting physical layers."""

from dsbrdf.components.component import Component, Decomposition
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.layers import (
    DiffuseLayer,
    Layer,
    LayeredModel,
    RetroLayer,
    SheenLayer,
    SpecularLayer,
    TurningLayer,
)
from dsbrdf.components.shares import LABELS
from dsbrdf.components.surfaces import Misfit, Surface

__all__ = [
    "LABELS",
    "Component",
    "Decomposition",
    "DiffuseLayer",
    "Layer",
    "LayeredModel",
    "Misfit",
    "RetroLayer",
    "SheenLayer",
    "SpecularLayer",
    "Surface",
    "TurningLayer",
    "decompose",
]
