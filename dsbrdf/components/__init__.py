"""Decompose a reflectance into components by fitting physical layers."""

from dsbrdf.components.component import Component as Component
from dsbrdf.components.component import Decomposition as Decomposition
from dsbrdf.components.decomposition import decompose as decompose
from dsbrdf.components.layers import DiffuseLayer as DiffuseLayer
from dsbrdf.components.layers import Layer as Layer
from dsbrdf.components.layers import LayeredModel as LayeredModel
from dsbrdf.components.layers import RetroLayer as RetroLayer
from dsbrdf.components.layers import SheenLayer as SheenLayer
from dsbrdf.components.layers import SpecularLayer as SpecularLayer
from dsbrdf.components.layers import TurningLayer as TurningLayer
from dsbrdf.components.shares import LABELS as LABELS
from dsbrdf.components.surfaces import Misfit as Misfit
from dsbrdf.components.surfaces import Surface as Surface
