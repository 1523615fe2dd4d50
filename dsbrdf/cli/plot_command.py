"""The command ``dsbrdf plot``: figures of a stored model."""

from pathlib import Path

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import Json, ModelFile, OutputFile
from dsbrdf.cli.source_files import read_grid, read_model
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.reduction import profiles
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.output.figures import IMAGE_FORMATS, encode_figure, overview_figure
from dsbrdf.output.parameters_figure import parameters_figure


def plot(
    model: ModelFile,
    measurement: Path | None = None,
    /,
    *,
    output: OutputFile,
    lobes: bool = False,
    json: Json = False,
) -> int:
    """Draw the fit of a measurement, or the parameters of a model; return the exit code.

    Parameters
    ----------
    measurement
        What was fitted: draws its profiles, the fit and the components; without it, the parameters over
        theta_diff.
    output
        The file to write: .png, .svg or .pdf.
    lobes
        Draw the lobes of the model instead of its components.
    """
    image_format = output.suffix.lower().removeprefix(".")
    if image_format not in IMAGE_FORMATS:
        raise InvalidArgumentError(f"{output}: the figure's file must end in {_endings()}")
    fitted, _ = read_model(model)
    if measurement is None:
        figure = parameters_figure(fitted, title=model.stem, model_lobes=lobes)
    else:
        figure = overview_figure(profiles(read_grid(measurement)), fitted, model_lobes=lobes)
    content = encode_figure(figure, image_format)
    write_atomically(output, [content])
    if json:
        print_json({"output": str(output), "format": image_format, "bytes": len(content)})
    return 0


def _endings() -> str:
    *others, last = (f".{name}" for name in IMAGE_FORMATS)
    return f"{', '.join(others)} or {last}"
