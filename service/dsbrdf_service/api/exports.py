"""Export a fit: the model, a component or the layers as files for other programs."""

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

from dsbrdf.data.merl_validation import FILE_SIZE
from dsbrdf.output.export import FORMATS, LAYERS, PARTS, check_holds_component, check_shader_options, export_model
from dsbrdf.output.export.examples import EXAMPLES, example
from dsbrdf.output.export.glsl import NAME

from ..compute.steps import export_step
from ..http import openapi
from ..http.names import content_disposition
from ..http.responses import BINARY, JSON, OpenFileResponse
from .context import CHECKED_QUERY, TheContext, TheRow
from .fields import Input


class Export(Input):
    """Query parameters of an export."""

    format: Annotated[
        Literal[*FORMATS],  # type: ignore[valid-type]
        Field(description="; ".join(f"`{name}`: {kind.purpose}" for name, kind in FORMATS.items()) + "."),
    ]
    component: Annotated[
        Literal[*PARTS] | None,  # type: ignore[valid-type]
        Field(
            description="One component instead of the whole fit, in a format that holds values or a shader; or "
            f"`{LAYERS}`, the layers of all components as a small model, in any format."
        ),
    ] = None
    name: Annotated[
        str | None, Field(description="Name of the function in `glsl`; all other names in the file begin with it.")
    ] = None
    sampling: Annotated[bool, Field(description="Add functions to `glsl` that draw directions.")] = False
    example: Annotated[
        bool,
        Field(
            description="Instead of the file, an example that shows it on a sphere and is saved beside it: for "
            f"{', '.join(f'`{name}`' for name in EXAMPLES)}."
        ),
    ] = False


router = APIRouter(prefix="/v1/fits", tags=["export"], dependencies=CHECKED_QUERY)
_MEDIA_TYPES = (BINARY, *(kind.media_type.partition(";")[0] for kind in FORMATS.values()))
# Binary comes first, because a generated client reads every answer as the first media type that it knows.
_EXPORTED = {name: openapi.file(name) for name in _MEDIA_TYPES} | {JSON: {"schema": {"type": "object"}}}


@router.get(
    "/{fit_id}/export",
    response_class=Response,
    responses={
        200: {"description": "The file; `Content-Disposition` names it.", "content": _EXPORTED},
        **openapi.problems("not-found", "fit-not-finished"),
    },
)
async def export_fit(
    request: Request, context: TheContext, row: TheRow, wanted: Annotated[Export, Query()]
) -> Response:
    """Return the model, one component, or the layers of all components, for another program."""
    loaded = await context.models.get(row.key)
    check_shader_options(wanted.format, wanted.name, sampling=wanted.sampling)
    if wanted.component not in (None, LAYERS):
        check_holds_component(wanted.format)
    name = "-".join(part for part in (row.name or row.id, wanted.component) if part)
    file = f"{name}.{FORMATS[wanted.format].suffix}"
    headers = {"Content-Disposition": content_disposition(file), "Content-Type": FORMATS[wanted.format].media_type}
    model = loaded.decomposition.layers if wanted.component == LAYERS else loaded.part(wanted.component)
    key, place = ("export", row.key, row.name, *wanted.model_dump().values()), FORMATS[wanted.format].time
    if wanted.example and wanted.format != "glsl":  # Other examples only name the exported file, so no export is made.
        return _example(Path(file), wanted, b"")
    if place != "short":
        arguments = model, wanted.format, name
        made = await context.in_process(request, key, export_step, *arguments, max_bytes=FILE_SIZE, place=place)
        return OpenFileResponse(made, headers)
    report = loaded.report if wanted.component is None else None
    export = partial(export_model, model, wanted.format, report, name=wanted.name, sampling=wanted.sampling)
    content = await context.computations.run(request, key, export)
    return _example(Path(file), wanted, content) if wanted.example else Response(content, 200, headers)


def _example(file: Path, wanted: Export, content: bytes) -> Response:
    beside, text = example(file, wanted.format, content, wanted.name or NAME)
    return Response(text, headers={"Content-Disposition": content_disposition(beside.name)}, media_type="text/plain")
