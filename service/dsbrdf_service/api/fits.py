"""Submit, list, follow, rename, cancel and delete fits."""

import asyncio
from collections.abc import AsyncIterable
from datetime import datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import Field
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from dsbrdf.engines.engine import Fault
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.report import SuggestedPair
from dsbrdf.result import verdict

from ..compute.computations import departure
from ..errors import InvalidKeyError, ProblemError
from ..http import openapi
from ..http.messages import BINARY, JSON, given_name, media_type_of, preferred_wait, prefix_of, tagged_reply
from ..storage.atlas import ATLAS, atlas_row
from ..storage.database import in_write_thread
from ..storage.schema import Caller, FitKey, FitRow, Status
from ..wire import MAX_NAME_LENGTH, canonical, check_name, from_query, from_wire
from .context import CHECKED_QUERY, Context, TheCaller, TheContext, TheFit, TheRow, TheTableOptions
from .fields import FIT_ID, PLAIN, SHA256, Document, Input, Name, Options, Page, Range, Share, members, next_page, parse
from .measurements import CONTENT, OPTION_PARAMETERS, PARAMETERS, TABLE_PARAMETERS, TABLES, receive_upload
from .results import ComponentDocument


class FitRequest(Input):
    """A request for a fit of a stored measurement."""

    measurement: Annotated[str, Field(pattern=SHA256, description="The measurement's sha256.")]
    options: Options = {}


class NewName(Input):
    """The new name of a fit, or null."""

    name: Annotated[str | None, Field(max_length=MAX_NAME_LENGTH, description="null takes the name away.")]


class FitSummary(Document):
    """The state of a fit, without its model."""

    id: Annotated[str, Field(pattern=FIT_ID)]
    name: Name
    status: Status
    progress: Share
    measurement: Annotated[str, Field(pattern=SHA256)]
    options: Options
    metrics: Metrics | None
    error: Fault | None
    """Why the fit failed; an equal request runs the fit again unless `origin` is `input`."""
    created: datetime
    started: datetime | None
    finished: datetime | None
    algorithm: str
    """Version of the fit algorithm."""
    library: str
    """Version of the library that accepted the fit."""
    likeness: str | None
    """How alike lit spheres of measurement and fit look, in words and dB."""


class FindingDocument(Document):
    """One thing to know about a measurement or a fit."""

    code: str
    """Kind of the finding, such as `clipped-highlight`; the page on faults of measurements lists all codes."""
    sentence: str
    numbers: dict[str, float]
    """The numbers in the sentence, by name."""


class FitDocument(FitSummary):
    """A fit: its state, and once it has succeeded its metrics, warnings, components and model."""

    warnings: list[str]
    """What to know before the fit is used, one sentence each."""
    findings: list[FindingDocument]
    """The warnings again, each with its code and its numbers."""
    measure_next: list[SuggestedPair]
    """Directions at which further samples would help most, the best first; empty on a grid."""
    components: list[ComponentDocument] | None
    """The components that reflect light, from narrow to wide."""
    diffuse_range: Range | None
    """Interval that contains the diffuse fraction of the reflected light with a probability of 90 %."""
    structures: list[dict[str, Any]] | None
    """The structures of layers that explain the model, each with its probability as `weight`."""
    model: dict[str, Any] | None
    """Parameters of the model as in the file of `export?format=json`: knots in radians, and control values of splines.
    `components` and `/brdf` have values at angles.
    """
    report: dict[str, Any] | None
    """How the fit went and how good it is: the fields of `dsbrdf.FitReport`."""
    format: Literal["dsbrdf"] | None
    """Format of the document as a file: `dsbrdf.load` reads the document of a fit that succeeded."""
    version: int | None
    """Version of the format."""


RESULT_MEMBERS = tuple(FitDocument.model_fields)[len(FitSummary.model_fields) :]
"""Members that the process of a fit writes into the stored document."""


class RemovedFit(Document):
    """The outcome of a DELETE request for a fit."""

    id: Annotated[str, Field(pattern=FIT_ID)]
    status: Literal["cancelled", "deleted"]
    """`cancelled`: the fit was unfinished and stays in the list. `deleted`: the fit had ended and was removed."""


class FitPage(Page):
    """Query parameters of a page of fits."""

    status: Annotated[Status | None, Field(description="Only fits in this state.")] = None
    measurement: Annotated[str | None, Field(pattern=SHA256, description="Only fits of this measurement.")] = None


class FitList(Document):
    """A page of fits, newest first."""

    items: list[FitSummary]


router = APIRouter(prefix="/v1/fits", tags=["fits"], dependencies=CHECKED_QUERY)
materials = APIRouter(prefix="/v1/materials", tags=["fits"], dependencies=CHECKED_QUERY)

_MAX_JSON_BYTES = 1 << 16
_NO_RESULT = to_json({"warnings": [], "findings": [], "measure_next": []} | dict.fromkeys(RESULT_MEMBERS[3:]))
_FILE_AS_JSON = (
    "The body is a file, but its Content-Type is application/json; send a MERL or RGL file as application/octet-stream "
    "and a table as text/csv."
)
_NO_CONTENT_TYPE = (
    "The body was taken for a file, because the request has no Content-Type; a document that names a stored "
    "measurement needs Content-Type: application/json."
)
_Wait = Annotated[
    float, Query(ge=0, allow_inf_nan=False, description="Answer when the fit has ended, or after this time [s]."), PLAIN
]
_Only = Annotated[
    Literal["cancel", "delete"] | None,
    Query(description="`cancel` refuses a fit that has ended, `delete` one that has not; otherwise what applies."),
]
_PREFER = openapi.header_parameter(
    "Prefer", "`wait=N`: wait at most N seconds for the fit. `respond-async`: do not wait."
)
_SUBMISSION_BODY = openapi.body(
    "A MERL file, an RGL .bsdf file, a table of scattered samples, or a reference to a stored measurement.",
    CONTENT | {JSON: {"schema": openapi.reference(FitRequest)}},
)


@router.post(
    "",
    status_code=201,
    response_model=FitDocument,
    responses={
        200: openapi.answer("An equal request was made before; its fit has ended.", FitDocument, "Location"),
        201: openapi.answer("The fit has ended; `Location` is its address.", FitDocument, "Location"),
        202: openapi.answer("The fit has not ended; request `Location` later.", FitDocument, "Location", "Retry-After"),
        **openapi.problems("not-found", "queue-quota", "queue-full", *openapi.UPLOAD_PROBLEMS),
    },
    openapi_extra={"parameters": [*PARAMETERS, *OPTION_PARAMETERS, *TABLE_PARAMETERS, _PREFER], **_SUBMISSION_BODY},
)
async def submit_fit(request: Request, context: TheContext, caller: TheCaller, table: TheTableOptions) -> Response:
    """Fit the measurement in the body, or a stored measurement.

    The answer comes when the fit has ended: 201, or 200 if an equal request was made before. A fit that failed is
    answered in the same way: its `status` is `failed` and its `error` says why. If the fit takes longer than
    `Prefer: wait=N` seconds (default 30), or with `Prefer: respond-async`, the answer is 202, and `Location` is the
    address of the fit.
    """
    name, chosen = given_name(request), from_query(request.query_params.multi_items())
    if media_type_of(request, BINARY, JSON, *TABLES) != JSON:
        try:
            stored, _ = await receive_upload(request, context, caller, name, table)
        except MeasurementFormatError as error:
            if "content-type" in request.headers:
                raise
            raise MeasurementFormatError(f"{error} {_NO_CONTENT_TYPE}") from None
        sha256, options, name = stored.sha256, canonical(chosen), name and stored.name
    else:
        if request.query_params.keys() - {"name"}:
            raise InvalidArgumentError("With a JSON body, the options are its member 'options', not query parameters.")
        document = await _requested(request, context)
        sha256, options = document.measurement, canonical(from_wire(document.options))
    row, new = await context.queue.submit(caller, sha256, options, name)
    if not row.ended:
        wait = preferred_wait(request, context.settings.default_wait_seconds, context.settings.max_wait_seconds)
        row = await _wait(request, context, caller, row.key, wait)
    status, headers = 201 if new else 200, {"Location": f"{prefix_of(request)}/v1/fits/{row.id}"}
    if not row.ended:
        status, headers["Retry-After"] = 202, "1"
    return Response(await _document(context, row), status, headers, JSON)


async def _requested(request: Request, context: Context) -> FitRequest:
    """Return the JSON document of a request; explain the mistake if a client sends a file as JSON."""
    if int(request.headers.get("content-length", 0)) > _MAX_JSON_BYTES:  # uvicorn refuses a length that is no number.
        raise ProblemError("too-large", _FILE_AS_JSON)
    async with context.bodies.received(request, _MAX_JSON_BYTES) as body:
        if body[:1].strip() not in (b"", b"{", b"[", b'"'):
            raise InvalidArgumentError(_FILE_AS_JSON)
        return parse(FitRequest, body)


@router.get("", response_model=FitList, responses={200: openapi.headers("Link"), **openapi.problems()})
async def list_fits(
    request: Request, context: TheContext, caller: TheCaller, page: Annotated[FitPage, Query()]
) -> Response:
    """Return a page of fits, newest first; `Link` with `rel="next"` leads to the next page."""
    rows = await run_in_threadpool(
        context.store.fits, caller.owner, page.limit + 1, page.cursor, page.name, page.status, page.measurement
    )
    items = b",".join(_summary(context, row) for row in rows[: page.limit])
    return Response(b'{"items":[%b]}' % items, 200, next_page(request, page, rows), JSON)


@materials.get("", response_model=FitList, responses=openapi.problems())
async def list_materials(context: TheContext, caller: TheCaller) -> Response:
    """Return the fits of measured materials that come with the service; they cannot be renamed or deleted."""
    rows = [await run_in_threadpool(atlas_row, FitKey(caller.owner, fit_id)) for fit_id in ATLAS]
    return Response(b'{"items":[%b]}' % b",".join(_summary(context, row) for row in rows), media_type=JSON)


@router.get("/{fit_id}", response_model=FitDocument, responses=openapi.TAGGED | openapi.problems("not-found"))
async def get_fit(request: Request, context: TheContext, caller: TheCaller, fit: TheFit, wait: _Wait = 0.0) -> Response:
    """Return a fit; with `wait`, the answer comes when the fit has ended or the time is over."""
    row = await _wait(request, context, caller, fit, min(wait, context.settings.max_wait_seconds))
    headers = {} if row.ended else {"Retry-After": "1"}
    return tagged_reply(request, await _document(context, row), headers=headers)


async def _own_fit(fit: TheFit) -> FitKey:
    """Return the key of a fit; refuse a fit that comes with the service, which nobody can change."""
    if fit.id in ATLAS:
        detail = "The fit comes with the service; it cannot be renamed or deleted."
        raise ProblemError("method-not-allowed", detail, {"Allow": "GET, HEAD"})
    return fit


_TheOwnFit = Annotated[FitKey, Depends(_own_fit)]


@router.patch(
    "/{fit_id}",
    response_model=FitDocument,
    responses=openapi.problems("not-found", "method-not-allowed", "too-large", "disk-full", *openapi.BODY_PROBLEMS),
    openapi_extra=openapi.body("The new name.", {JSON: {"schema": openapi.reference(NewName)}}),
)
async def rename_fit(request: Request, context: TheContext, fit: _TheOwnFit) -> Response:
    """Rename a fit, or remove its name; nothing else of a fit can be changed."""
    media_type_of(request, JSON)
    async with context.bodies.received(request, _MAX_JSON_BYTES) as body:
        given = parse(NewName, body)
    name = None if given.name is None else check_name(given.name)
    row = await in_write_thread(context.store.rename_fit, fit, name)
    return Response(await _document(context, row), media_type=JSON)


@router.delete(
    "/{fit_id}",
    responses=openapi.problems("not-found", "method-not-allowed", "fit-ended", "fit-not-finished", "disk-full"),
)
async def delete_fit(context: TheContext, fit: _TheOwnFit, only: _Only = None) -> RemovedFit:
    """Cancel an unfinished fit, which stays in the list, or delete a fit that has ended; the answer says which.

    With `only=cancel`, a fit that ends just before the request is not deleted. With `only=delete`, no fit is cancelled.
    """
    if only != "delete" and await context.queue.cancel(fit) is not None:
        return RemovedFit(id=fit.id, status="cancelled")
    if only != "cancel" and await in_write_thread(context.store.remove_fit, fit):
        return RemovedFit(id=fit.id, status="deleted")
    row = await run_in_threadpool(context.store.fit, fit)
    if not row.ended:
        raise ProblemError("fit-not-finished", f"The fit is {row.status}; only=cancel cancels it.")
    detail = f"The fit has ended as {row.status}, there is nothing to cancel; only=delete deletes it."
    raise ProblemError("fit-ended", detail)


async def _check_room(context: TheContext, caller: TheCaller) -> None:
    """Refuse a stream of events if the caller follows so many fits that only requests of other kinds are left."""
    if not context.queue.has_room(caller.owner):
        detail = "Your requests follow as many fits as is allowed; end one of them, or ask for the fit with GET."
        raise ProblemError("too-many-at-once", detail, {"Connection": "close"})


@router.get(
    "/{fit_id}/events",
    response_class=EventSourceResponse,
    response_description="Events until the fit has ended; the data of each is a `FitSummary`.",
    responses={
        200: {"content": {"text/event-stream": {"example": openapi.EXAMPLE_EVENTS}}},
        **openapi.problems("not-found"),
    },
    dependencies=[Depends(_check_room)],
)
async def follow_fit(context: TheContext, caller: TheCaller, begin: TheRow) -> AsyncIterable[ServerSentEvent]:
    """Send an event at every step of a fit; an event's name is the fit's status, and the last event reports its end."""
    async for row in context.queue.watch(begin.key):
        if not context.keys.allows(caller):
            return
        yield ServerSentEvent(raw_data=_summary(context, row).decode(), event=row.status)


async def _wait(request: Request, context: Context, caller: Caller, fit: FitKey, seconds: float) -> FitRow:
    """Return the fit's row when it has ended or after `seconds`.

    The wait ends early when the client closes the connection. Raises InvalidKeyError if the key was revoked during the
    wait.
    """
    if not seconds:
        return await run_in_threadpool(context.store.fit, fit)
    gone = asyncio.create_task(departure(request))
    try:
        row = await context.queue.wait(fit, seconds, gone)
    finally:
        gone.cancel()
    if not context.keys.allows(caller):
        raise InvalidKeyError
    return row


def _summary(context: Context, row: FitRow) -> bytes:
    metrics = row.metrics or {}
    more = {"progress": context.queue.progress(row), "likeness": verdict(Metrics(**metrics)) if metrics else None}
    return to_json(members(FitSummary, row) | more)


async def _document(context: Context, row: FitRow) -> bytes:
    """Return the `FitDocument` of a fit's row: its state, and the stored bytes of its result, which are not parsed."""
    result = _NO_RESULT
    if row.status == "succeeded":
        result = await run_in_threadpool(context.store.result, row.key)
    return _summary(context, row)[:-1] + b"," + result[1:]
