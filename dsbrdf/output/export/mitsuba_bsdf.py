"""Use a model as a BSDF of Mitsuba 3, with the model's own sampling.

    import mitsuba
    from dsbrdf.output.export.mitsuba_bsdf import register

    mitsuba.set_variant("llvm_ad_rgb")
    register()
    bsdf = mitsuba.load_dict({"type": "dsbrdf", "filename": "nickel.json"})

`mitsuba.traverse` lists the model's parameters, which are differentiable in variants with derivatives. The parameters
are arrays of `dsbrdf.DSBRDF`: amplitude, kappa and gamma, center of the ring lobes, and elongation of the lobes that
are not round. ``bsdf.model()`` returns the model with the current parameters. Directions are drawn with the densities
of the loaded model even after a change, which gives correct means for any parameters.

All variants without polarisation work: scalar variants compute one ray at a time, slowly; LLVM and CUDA variants, many
rays at once. Spectral variants turn RGB values into spectra with `dsbrdf.output.export.rgl.SPECTRA`.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

from dsbrdf.errors import DSBRDFError, InvalidArgumentError
from dsbrdf.extras import require
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export.mitsuba_model import MitsubaModel, Number, Table
from dsbrdf.output.export.rgl import SPECTRA, WAVELENGTHS
from dsbrdf.output.serialize import read_model_file
from dsbrdf.rendering.environment import LUMINANCE


def register() -> None:
    """Register the BSDF ``dsbrdf`` with the active variant of Mitsuba.

    The BSDF has one property, ``filename``, the path of a model in JSON. Raises MissingExtraError if Mitsuba is not
    installed, and InvalidArgumentError if no variant is set, or the variant has polarisation.
    """
    require("mitsuba", "mitsuba", purpose="the BSDF of a model")
    mitsuba = import_module("mitsuba")
    if mitsuba.variant() is None or mitsuba.is_polarized:
        raise InvalidArgumentError(
            "set a variant of Mitsuba without polarisation first, such as mitsuba.set_variant('llvm_ad_rgb')"
        )
    mitsuba.register_bsdf("dsbrdf", _bsdf_class(mitsuba))


def _file_and_model(mitsuba: Any, properties: Any) -> tuple[str, DSBRDF]:
    """Return the path in the properties of a BSDF, and the model in the file at this path; an error names the file."""
    name, wanted = properties.get("filename", None), "the .json file of a model"
    if not isinstance(name, str):
        raise InvalidArgumentError(f'the BSDF "dsbrdf" needs the property "filename", a text: {wanted}')
    path = Path(str(mitsuba.file_resolver().resolve(name)))
    if not path.is_file():
        raise InvalidArgumentError(f'there is no file {path}; the BSDF "dsbrdf" needs {wanted}')
    try:
        return str(path), read_model_file(path)[0]
    except DSBRDFError as error:
        raise type(error)(f"{path}: {error}") from None


def _bsdf_class(mitsuba: Any) -> Any:
    """Define the BSDF as a class of Mitsuba's active variant."""
    dr, lobe = import_module("drjit"), mitsuba.BSDFFlags.GlossyReflection

    class DirectionalStatistics(mitsuba.BSDF):  # type: ignore[misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.filename, model = _file_and_model(mitsuba, properties)
            self.material, self._spectrum = MitsubaModel(model), _Spectrum(mitsuba)
            self.m_components = [lobe | mitsuba.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def eval(self, context: Any, surface: Any, wo: Any, active: Any = True) -> Any:
            value = self._spectrum(self.material.brdf(wo, surface.wi), surface.wavelengths) * wo.z
            return dr.select(active & _reflects(context, surface, wo, lobe), value, 0.0)

        def pdf(self, context: Any, surface: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(active & _reflects(context, surface, wo, lobe), self.material.pdf(wo, surface.wi), 0.0)

        def sample(self, context: Any, surface: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            result = mitsuba.BSDFSample3f()
            result.wo, result.eta = self.material.sample(surface.wi, sample1, sample2), 1.0
            result.pdf = self.pdf(context, surface, result.wo, active)
            result.sampled_type, result.sampled_component = mitsuba.UInt32(+lobe), mitsuba.UInt32(0)
            drawn = result.pdf > 0.0
            weight = self.eval(context, surface, result.wo, active & drawn) / dr.select(drawn, result.pdf, 1.0)
            return result, weight

        def traverse(self, callback: Any) -> None:
            for name, tensor in self.material.parameters.items():
                callback.put(name, tensor, mitsuba.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Any) -> None:  # noqa: ARG002 (all parameters are read)
            self.material.update()

        def model(self) -> DSBRDF:
            return self.material.changed_model()

        def to_string(self) -> str:
            return f"DirectionalStatistics[filename = {self.filename}]"

    return DirectionalStatistics


def _reflects(context: Any, surface: Any, wo: Any, lobe: Any) -> Any:
    """Return whether both directions are above the surface and Mitsuba's context asks for this kind of BSDF."""
    return (surface.wi.z > 0.0) & (wo.z > 0.0) & context.is_enabled(lobe)


class _Spectrum:
    """Turn RGB values into spectra of the active variant of Mitsuba."""

    def __init__(self, mitsuba: Any) -> None:
        self._mitsuba, self._spectra = mitsuba, Table(SPECTRA)

    def __call__(self, color: list[Number], wavelengths: Number) -> Any:
        mitsuba = self._mitsuba
        if mitsuba.is_spectral:
            return mitsuba.Spectrum([self._at_wavelength(color, at) for at in wavelengths])
        if mitsuba.is_monochromatic:
            return mitsuba.Spectrum(sum(part * weight for part, weight in zip(color, LUMINANCE.tolist(), strict=True)))
        return mitsuba.Spectrum(*color)

    def _at_wavelength(self, color: list[Number], wavelength: Number) -> Number:
        """Return the spectrum of a colour, interpolated linearly at one wavelength."""
        dr, mitsuba = import_module("drjit"), self._mitsuba
        first, step, count = float(WAVELENGTHS[0]), float(WAVELENGTHS[1] - WAVELENGTHS[0]), WAVELENGTHS.size
        place = dr.clip((wavelength - first) / step, 0.0, count - 1.0)
        node = dr.minimum(mitsuba.UInt32(place), count - 2)
        share = place - mitsuba.Float(node)
        total = mitsuba.Float(0.0)
        for channel, value in enumerate(color):
            left, right = (self._spectra[channel * count + node + i] for i in (0, 1))
            total = total + value * (left + share * (right - left))
        return total
