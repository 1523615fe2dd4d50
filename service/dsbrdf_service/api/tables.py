"""Describe tables of samples, so that they can be checked before an upload."""

import hashlib
from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, Field
from starlette.requests import Request

from dsbrdf.output.table_summary import ANGLE_NAMES
from dsbrdf.samples.reading import START_BYTES

from ..compute.steps import understood_step
from ..http import openapi
from ..http.request_body import media_type_of
from .context import CHECKED_QUERY, TheCaller, TheContext, TheTableOptions
from .fields import Range, Share
from .uploads import CONTENT, MAX_CONVERTED_BYTES, TABLE_PARAMETERS, UPLOADED, place_of_table, read_table


class ColumnDocument(BaseModel):
    """A column of a table."""

    name: str
    read_as: Annotated[str | None, Field(description="What it means; null if it is not read.")]
    unit: Annotated[str, Field(description="The unit that the table states; empty if it states none.")]


class TableDocument(BaseModel):
    """Columns, ranges and samples of a table, as the library reads it."""

    n_rows: int
    n_samples: Annotated[int, Field(description="Rows that can be fitted.")]
    columns: list[ColumnDocument]
    ranges: Annotated[
        dict[str, Range],
        Field(description=f"Smallest and largest of {', '.join(ANGLE_NAMES)}, red, green and blue [1/sr]."),
    ]
    angles_of_incidence_deg: Annotated[list[float] | None, Field(description="Angles theta_in, if they are few.")]
    in_plane_of_incidence: Annotated[Share, Field(description="Fraction of the samples in the plane of incidence.")]
    warnings: list[str]
    first: Annotated[list[list[float]], Field(description="The first samples, with numbers in the order of `ranges`.")]


router = APIRouter(prefix="/v1/tables", tags=["measurements"], dependencies=CHECKED_QUERY)


@router.post(
    "",
    responses=openapi.problems("too-large", "measurement-format", *openapi.BODY_PROBLEMS),
    openapi_extra={
        "parameters": [*TABLE_PARAMETERS, openapi.ENCODING],
        **openapi.body("A table of scattered samples.", CONTENT),
    },
)
async def describe_table(
    request: Request, context: TheContext, caller: TheCaller, options: TheTableOptions
) -> TableDocument:
    """Return columns, units, ranges, warnings and the first samples of the table in the body.

    Nothing is stored, so the right options can be found before the upload.
    """
    media_type_of(request, *UPLOADED)
    async with context.bodies.received(request, MAX_CONVERTED_BYTES) as content:
        key = caller.owner, "table", hashlib.sha256(content).hexdigest(), options
        place = place_of_table(content[:START_BYTES], len(content))
        found = await read_table(request, context, key, understood_step, content, options, place=place)
    return TableDocument(**found)
