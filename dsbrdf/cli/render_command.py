"""The command ``dsbrdf render``: lit spheres of models and measurements as a PNG file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import Component, Json, OutputFile, RequiredFiles, Whole
from dsbrdf.cli.source_files import named_in_errors, named_part, read_source
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.environment import EnvironmentMap, read_environment
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import LIGHTINGS, render_sphere, sphere_normals
from dsbrdf.output.png import encode_png
from dsbrdf.output.sphere_panels import compare_spheres, side_by_side

Array = NDArray[np.float64]

_PICTURES = (".hdr", ".exr")


@Parameter(name="*")
@dataclass(frozen=True)
class Look:
    """How spheres are drawn.

    Attributes
    ----------
    lighting
        three_lights, environment, or a panorama of 360 by 180 degrees, .hdr or .exr.
    size
        Of a sphere [pixels].
    component
        One component, or the guide (all components' own lobes), instead of the model.
    exposure
        What radiance is multiplied by before it is clipped at 1 and gets the sRGB curve; by default the 99th percentile
        of the whole material, or of the first source, becomes 1.
    """

    lighting: Annotated[str, Parameter(metavar="NAME|FILE")] = LIGHTINGS[0]
    size: Annotated[int, Whole, Parameter(metavar="PIXELS")] = 256
    component: Component = None
    exposure: Annotated[float | None, Parameter(metavar="FACTOR")] = None

    def __post_init__(self) -> None:
        if self.lighting not in LIGHTINGS and not self.lighting.lower().endswith(_PICTURES):
            raise InvalidArgumentError(
                f"--lighting: must be {', '.join(LIGHTINGS)} or a .hdr or .exr file, not {self.lighting!r}"
            )
        if self.exposure is not None and not 0.0 < self.exposure < float("inf"):
            raise InvalidArgumentError(f"the exposure must be a positive number, not {self.exposure:g}")

    def light(self) -> str | EnvironmentMap:
        """Return the name of the lighting, or the panorama; an error names its file."""
        if self.lighting in LIGHTINGS:
            return self.lighting
        with named_in_errors(Path(self.lighting)):
            return read_environment(self.lighting)


_USUAL = Look()


def render(*sources: RequiredFiles, output: OutputFile, look: Look = _USUAL, json: Json = False) -> int:
    """Draw a lit sphere of a model or a measurement; return the exit code.

    Parameters
    ----------
    sources
        A .json or .npz model, or a .binary or .bsdf measurement; a second one, a model, is compared with the first:
        the picture then shows both, their difference and the components of the model.
    output
        The file to write, a .png.
    """
    if output.suffix.lower() != ".png":
        raise InvalidArgumentError(f"{output}: the picture's file must end in .png")
    if len(sources) > 2:
        raise InvalidArgumentError(f"one or two sources can be drawn, not {len(sources)}")
    image, about = _sphere(sources[0], look) if len(sources) == 1 else _comparison(sources[0], sources[1], look)
    write_atomically(output, [encode_png(image)])
    if json:
        print_json({"output": str(output), "lighting": look.lighting} | about)
        return 0
    print(f"{output}: {look.lighting}, radiance times {about['exposure']:.4g}, clipped at 1, sRGB curve")
    if "panels" in about:
        print(f"from left to right: {', '.join(about['panels'])}")
        psnr = "infinite" if about["psnr"] is None else f"{about['psnr']:.1f} dB"
        print(f"likeness of the fit: PSNR {psnr}, SSIM {about['ssim']:.4f}")
    return 0


def _sphere(path: Path, look: Look) -> tuple[Array, dict[str, Any]]:
    """Picture of one source, or of one of its components, and what to report."""
    light, whole = look.light(), read_source(path)
    if look.component is not None and isinstance(whole, Measurement):
        raise InvalidArgumentError(f"{path}: a measurement has no components; fit it first")
    part = whole if isinstance(whole, Measurement) else named_part(path, whole, look.component)
    image = render_sphere(part, lighting=light, size=look.size)
    factor = look.exposure
    if factor is None:
        of_whole = image if part is whole else render_sphere(whole, lighting=light, size=look.size)
        factor = exposure(of_whole, sphere_normals(look.size)[1])
    return displayed(image, factor), {"exposure": factor}


def _comparison(first: Path, second: Path, look: Look) -> tuple[Array, dict[str, Any]]:
    """Panels of two sources, and what to report."""
    if look.component is not None:
        raise InvalidArgumentError("a comparison shows all components: leave --component out")
    light, measured, fit = look.light(), read_source(first), read_source(second)
    if not isinstance(fit, DSBRDF):
        raise InvalidArgumentError(f"{second}: the second source must be a model, the fit of the first")
    found = compare_spheres(measured, fit, lighting=light, size=look.size, factor=look.exposure)
    psnr = found.psnr if np.isfinite(found.psnr) else None
    about = {"exposure": found.exposure, "panels": list(found.panels), "psnr": psnr, "ssim": found.ssim}
    return side_by_side(found.panels), about
