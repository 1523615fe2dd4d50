"""Describe a component by the parameters of layers fitted to its own values.

The decomposition uses strong priors on usual materials to assign light to components. The parameters of a component are
then estimated from its values alone: layers of any colour, with weak priors, are fitted to the values. The layers of a
highlight are up to two rough surfaces, and the layers of a diffuse part are a diffuse layer with or without sheen. The
misfit is the distance of the fitted layers from the values; a parameter with too large a misfit is None.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from dsbrdf.arrays import Evaluate
from dsbrdf.components.layer_data import component_data, peak_half_width, renderer_data
from dsbrdf.components.layer_fit import fit_structures, refined
from dsbrdf.components.layer_priors import OWN_PRIORS
from dsbrdf.components.layers import DiffuseLayer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer
from dsbrdf.components.points import light_rules
from dsbrdf.components.shares import SurfaceSpread
from dsbrdf.components.structures import LayerStructure
from dsbrdf.components.surfaces import (
    MAX_RANGE_FACTOR,
    MIN_ALPHA_RATIO,
    Misfit,
    OwnValues,
    Surface,
    albedo_of,
    half_width_of,
    surfaces_of,
)

_SECOND_SURFACE_COST = 40.0  # A second surface is kept only if it lowers the cost of the fit by more than this.
_FAINT_GROUND = DiffuseLayer((0.005, 0.005, 0.005), (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
"""Start of a layer for faint light far from the highlights of a material without a diffuse part."""
_MAX_START_HALF_WIDTH = np.radians(35.0)


@dataclass(frozen=True)
class Description:
    """The layers fitted to a component, the surfaces among these layers, and the misfit of the layers."""

    layers: LayeredModel
    surfaces: tuple[Surface, ...]
    misfit: Misfit

    @property
    def half_width(self) -> float | None:
        """Half width [rad] of the distribution of slopes of all surfaces; None if the misfit is too large."""
        return None if self.misfit.half_width is None or self.misfit.withholds_roughness else self.surface_half_width

    @property
    def surface_half_width(self) -> float | None:
        """Half width [rad] of the distribution of slopes of all surfaces, whatever the misfit is."""
        return half_width_of([layer for layer in self.layers.layers if isinstance(layer, (SpecularLayer, RetroLayer))])

    def without_highlight(self) -> "Description":
        """Withhold what the shape of a highlight determines, because the highlight of the measurement is clipped."""
        withheld = tuple(Surface(*[None] * len(fields(Surface))) for _ in self.surfaces)
        return replace(self, surfaces=withheld, misfit=replace(self.misfit, half_width=None))

    def remarks(self, label: str) -> tuple[str, ...]:
        """Return a sentence about each parameter that the misfit or the uncertainty withholds."""
        return (*self.misfit_remarks(label), *self._grazing_remarks(label))

    def misfit_remarks(self, label: str) -> Iterator[str]:
        """Yield a sentence if the misfit withholds roughness or reflectance."""
        misfit, misses = self.misfit, self.misfit.in_words
        withheld = (("alpha", misfit.withholds_roughness), ("F0", misfit.withholds_reflectance))
        names = [name for name, is_withheld in withheld if is_withheld]
        if self.surfaces and names:
            missed = f"{', '.join(misses[:-1])} and {misses[-1]}" if len(misses) > 1 else misses[0]
            component = label.replace("_", " ")
            yield f"The {component} has no {' or '.join(names)}: its surfaces miss {missed}."

    def _grazing_remarks(self, label: str) -> Iterator[str]:
        if found := [str(number) for number, one in enumerate(self.surfaces, 1) if one.f0 and one.f70 is None]:
            which = f"surface{'s' * (len(found) > 1)} {' and '.join(found)} of the {label.replace('_', ' ')}"
            yield f"F70 of {which} is left out: it is uncertain by more than a factor of {MAX_RANGE_FACTOR:g}."


def describe(
    own: OwnValues, spread: SurfaceSpread, *, is_diffuse: bool, has_retro: bool = False, has_ground: bool = False
) -> Description:
    """Fit layers to the values of a component.

    The layers of a highlight may include a retro layer (`has_retro`) or a diffuse layer (`has_ground`).
    """
    data = component_data(own.grid, has_peak=not is_diffuse)
    if data is None:
        return Description(LayeredModel(()), (), Misfit(None, 0.0, None, 0.0))
    structures: tuple[LayerStructure, ...] = _DIFFUSE_STRUCTURES
    if not is_diffuse:
        structures = _highlights(peak_half_width(own.grid), has_retro=has_retro, has_ground=has_ground)
    best = fit_structures(data, structures, quick=True)[0]
    albedo = albedo_of(best.model)
    misfit = Misfit.of(own, albedo, best.model, is_diffuse=is_diffuse)
    alphas = [layer.alpha for layer in best.model.layers if isinstance(layer, SpecularLayer)]
    if len(alphas) > 1 and max(alphas) <= MIN_ALPHA_RATIO * min(alphas):
        alone = fit_structures(data, structures[:1], quick=True)[0]
        of_one = albedo_of(alone.model)
        misfit_of_one = Misfit.of(own, of_one, alone.model, is_diffuse=is_diffuse)
        if not (misfit_of_one.withholds_roughness or misfit_of_one.withholds_reflectance):
            best, albedo, misfit = alone, of_one, misfit_of_one
    surfaces = () if is_diffuse else surfaces_of(best, misfit, own, albedo, spread)
    return Description(best.model, surfaces, misfit)


def renderer_layers(evaluate: Evaluate, descriptions: Sequence[Description]) -> LayeredModel:
    """Fit the layers of all components, and a diffuse layer, together to the whole material, for renderers."""
    layers = [layer for one in descriptions for layer in one.layers.layers]
    data = renderer_data(evaluate, light_rules()[:2])
    if data is None or not layers:
        return LayeredModel(())
    if not any(isinstance(layer, DiffuseLayer) for layer in layers):
        layers.append(_FAINT_GROUND)
    structure = LayerStructure("all", tuple(OWN_PRIORS[type(layer)] for layer in layers))
    return refined(data, structure, np.concatenate([layer.unknowns for layer in layers])).model


_SURFACE_PRIOR = OWN_PRIORS[SpecularLayer].unrefracted()
_GROUND_PRIOR = OWN_PRIORS[DiffuseLayer]
_DIFFUSE_STRUCTURES = (
    LayerStructure("ground", (_GROUND_PRIOR,)),
    LayerStructure("ground and sheen", (_GROUND_PRIOR, OWN_PRIORS[SheenLayer]), 2.0),
)


def _highlights(half_width: float, *, has_retro: bool, has_ground: bool) -> tuple[LayerStructure, ...]:
    """Return structures of one or two surfaces whose fits start near a half width [rad].

    `has_retro` adds structures with a retro layer, and `has_ground` a structure with a diffuse layer.
    """
    width = float(np.degrees(half_width))
    widest = float(np.degrees(_MAX_START_HALF_WIDTH))
    pairs = ((0.7 * width, min(3.0 * width, widest)), (width, min(6.0 * width, widest)))
    cost = _SECOND_SURFACE_COST
    found = [
        LayerStructure("surface", (_SURFACE_PRIOR,), 0.0, ((width,),)),
        LayerStructure("two surfaces", (_SURFACE_PRIOR, _SURFACE_PRIOR), cost, pairs),
    ]
    if has_ground:
        layers = _SURFACE_PRIOR, _SURFACE_PRIOR, _GROUND_PRIOR
        found.append(LayerStructure("two surfaces and ground", layers, 2.0 * cost, pairs[:1]))
    if has_retro:
        retro = OWN_PRIORS[RetroLayer]
        found.append(LayerStructure("retro-reflection", (retro,)))
        found.append(LayerStructure("retro-reflection and surface", (retro, _SURFACE_PRIOR), cost, ((width,),)))
    return tuple(found)
