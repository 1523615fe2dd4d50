"""Use a model as a BSDF of Mitsuba 3, with the model's own sampling.

    import mitsuba
    from dsbrdf.output.export.mitsuba import register

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

from collections.abc import Collection
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from dsbrdf.data.geometry import half_difference
from dsbrdf.errors import DSBRDFError, InvalidArgumentError
from dsbrdf.extras import require
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.sampling import ANGLES, in_plane_of_incidence, mirrored, mirrored_density
from dsbrdf.output.export.formula import ScalarArray, array_library, compiled, direction
from dsbrdf.output.export.rgl import SPECTRA, WAVELENGTHS
from dsbrdf.output.serialize import read_model_file
from dsbrdf.rendering.environment import LUMINANCE

Number = Any
"""A float or int of Python, or an array of drjit."""
PARAMETERS = ("amplitude", "kappa", "gamma", "center", "elongation")
"""Names of the arrays of `DSBRDF` that can be changed in Mitsuba."""
_MIN_LOG_PARAMETER = 1e-9  # Parameters that are interpolated as logarithms are clipped at this minimum.


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

        def parameters_changed(self, keys: Any) -> None:
            self.material.update(keys or self.material.parameters)

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


class Table:
    """Look up the numbers of an array by their index in the flattened array."""

    def __init__(self, values: Any) -> None:
        self._drjit, self._float = import_module("drjit"), import_module("mitsuba").Float
        flat = np.ravel(np.asarray(values, dtype=np.float32))
        self._values = flat.tolist() if self._float is float else self._float(flat)

    def __getitem__(self, index: Number) -> Number:
        return self._values[index] if self._float is float else self._drjit.gather(self._float, self._values, index)


def _log1p(x: Number) -> Number:
    """Return the logarithm of 1 + x for x >= 0."""
    dr = import_module("drjit")
    s = x / (2.0 + x)
    t = s * s
    series = 2.0 * s * (1.0 + t * (1.0 / 3.0 + t * (0.2 + t * (1.0 / 7.0 + t * (1.0 / 9.0)))))
    return dr.select(x < 0.5, series, dr.log(1.0 + x))


def _expm1(x: Number) -> Number:
    dr = import_module("drjit")
    y = dr.clip(x, -0.3, 0.3)
    series = y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0))))))
    return dr.select(dr.abs(x) < 0.3, series, dr.exp(dr.clip(x, -80.0, 88.0)) - 1.0)


class MitsubaModel:
    """Evaluate and sample a model in the arrays of the active variant of Mitsuba.

    The dict `parameters` has a tensor for each name in `PARAMETERS`. The tensors have the shapes of the arrays in
    `DSBRDF`, except that center has only the ring lobes, and elongation only the lobes that are not round. The density
    of sampled directions does not change with the parameters.
    """

    def __init__(self, model: DSBRDF) -> None:
        self._dr, self._mitsuba = import_module("drjit"), import_module("mitsuba")
        dr = self._dr
        self._lobes_with = dict.fromkeys(PARAMETERS, np.ones(model.n_lobes, np.bool_))
        self._lobes_with |= {"center": model.is_ring, "elongation": np.asarray(model.elongation.any(axis=0))}
        self.parameters: dict[str, Any] = {
            name: self._mitsuba.TensorXf(getattr(model, name)[..., lobes].astype(np.float32))
            for name, lobes in self._lobes_with.items()
            if lobes.any()
        }
        functions = {name: getattr(dr, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan")}
        functions |= {"arctan": dr.atan, "expm1": _expm1, "log1p": _log1p}
        functions |= {"minimum": dr.minimum, "maximum": dr.maximum, "where": dr.select}
        self._functions, self._array_library = SimpleNamespace(**functions), array_library(dr.is_array_v, functions)
        self._model, self._evaluate = model, compiled(model, self._array_library)
        self._scalar_model, self._changed = model, set[str]()
        sampler = model.sampler
        self._mixture_width = sampler.cumulative.shape[1]
        self._mixture_along, self._mixture_across = Table(sampler.along), Table(sampler.across)
        self._mixture_cumulative = Table(sampler.cumulative)
        self._mixture_fraction = Table(np.diff(sampler.cumulative, axis=1, prepend=0.0))

    def changed_model(self) -> DSBRDF:
        """Return the model with the current parameters."""
        arrays = {name: np.array(getattr(self._model, name)) for name in self.parameters}
        for name, tensor in self.parameters.items():
            changed = arrays[name][..., self._lobes_with[name]]
            arrays[name][..., self._lobes_with[name]] = np.array(tensor, dtype=np.float64).reshape(changed.shape)
        for name in self._bounds.keys() & arrays.keys():
            arrays[name] = np.maximum(arrays[name], self._bounds[name])
        return replace(self._model, **arrays)  # type: ignore[arg-type]  # Fields with these names are arrays.

    @property
    def _bounds(self) -> dict[str, float]:
        """Return the minimum of each bounded parameter, which is above 0 if the model is undefined at 0."""
        least = _MIN_LOG_PARAMETER if self._model.interpolation == "spline" else 0.0
        return {"amplitude": least, "kappa": _MIN_LOG_PARAMETER, "gamma": least}

    def update(self, names: Collection[str]) -> None:
        """Compute with the current values of the parameters of these names from now on."""
        self._changed |= set(names)
        if self._mitsuba.Float is float:
            self._scalar_model = self.changed_model()

    def _current(self, name: str) -> Any:
        """Return the elements of a parameter in the shape of its array in `DSBRDF`."""
        result = getattr(self._model, name).astype(object).view(ScalarArray)
        elements = result[..., self._lobes_with[name]]
        for place, index in enumerate(np.ndindex(elements.shape)):
            elements[index] = self._dr.gather(self._mitsuba.Float, self.parameters[name].array, place)
        result[..., self._lobes_with[name]] = elements
        return self._array_library.maximum(result, self._bounds[name]) if name in self._bounds else result

    def brdf(self, omega_in: Number, omega_out: Number) -> list[Number]:
        """Return RGB values [1/sr]; those of directions below the horizon have no meaning."""
        if self._mitsuba.Float is float:
            if min(omega_in.z, omega_out.z) <= 0.0:
                return [0.0, 0.0, 0.0]
            angles = half_difference(np.array(omega_in, np.float64), np.array(omega_out, np.float64))
            return list(self._scalar_model.evaluate(*angles).tolist())
        # The other parameters are constants of the compiled kernels, which is faster.
        differentiated = {name for name, tensor in self.parameters.items() if self._dr.grad_enabled(tensor)}
        changed = {name: self._current(name) for name in self._changed | differentiated}
        return list(self._evaluate(direction(omega_in), direction(omega_out), **changed)[0])

    def pdf(self, omega_in: Number, omega_out: Number) -> Number:
        """Return the density per solid angle [1/sr] of omega_in, for directions above the horizon."""
        width, row = self._mixture_width, self._row_of(omega_out)
        seen = in_plane_of_incidence(omega_in, omega_out, self._functions)
        result = self._mixture_fraction[row * width + width - 1] * omega_in.z / np.pi
        for part in range(width - 1):
            at = row * (width - 1) + part
            density = mirrored_density(seen, self._mixture_along[at], self._mixture_across[at], self._functions)
            result = result + self._mixture_fraction[row * width + part] * density
        return result

    def sample(self, omega_out: Number, one: Number, two: Number) -> Number:
        """Draw omega_in, possibly below the horizon, from a uniform random number `one` and a pair of them, `two`."""
        dr, width, row = self._dr, self._mixture_width, self._row_of(omega_out)
        chosen = self._mitsuba.UInt32(0)
        for part in range(width - 1):
            chosen = dr.select(one >= self._mixture_cumulative[row * width + part], part + 1, chosen)
        at = row * (width - 1) + dr.minimum(chosen, width - 2)
        along, across, azimuth = self._mixture_along[at], self._mixture_across[at], 2.0 * np.pi * two.y
        drawn = mirrored(omega_out, along, across, two.x, (dr.cos(azimuth), dr.sin(azimuth)), self._functions)
        cosine = self._mitsuba.warp.square_to_cosine_hemisphere(two)
        return dr.select(chosen == width - 1, cosine, self._mitsuba.Vector3f(*drawn))

    def _row_of(self, omega_out: Number) -> Number:
        """Return the index in `ANGLES` of the angle that is nearest to the direction's angle to the normal."""
        dr = self._dr
        theta = dr.atan2(dr.sqrt(dr.maximum(omega_out.x**2 + omega_out.y**2, 1e-30)), omega_out.z)
        nearest = dr.clip(dr.round(theta / float(ANGLES[1])), 0.0, float(ANGLES.size - 1))
        return self._mitsuba.UInt32(nearest)
