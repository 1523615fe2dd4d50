"""Fits: submit, look up, follow, cancel and delete."""

import asyncio
from collections.abc import AsyncIterable
from contextlib import suppress
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from dsbrdf import FitOptions, InvalidArgumentError
from service.access.authentication import caller_of, fit_of, over_quota, owner_of
from service.context import Context, context_of
from service.http import examples, openapi
from service.http.problems import ProblemError, sentence
from service.http.request_body import receive_measurement, receive_small
from service.http.responses import json_reply, next_page, preferred_wait, tagged_reply
from service.jobs.model_cache import no_such_fit, no_such_measurement
from service.storage.quota import QueueQuotaError, StorageQuotaError
from service.storage.rows import Caller, FitKey, FitRow
from service.storage.store import MissingMeasurementError, QueueFullError
from service.wire.conversions import fit_document, fit_progress, fit_summary
from service.wire.option_parsing import parse_options, parse_query
from service.wire.schemas import FIT_ID, FitDocument, FitList, FitRequest, Page, Progress, Waiting

router = APIRouter(prefix="/v1/fits", tags=["fits"])
FitId = Annotated[str, Path(pattern=FIT_ID, description="The fit's id.", examples=[examples.FIT_ID])]

_LARGEST_JSON = 1 << 16
_RAW = "application/octet-stream"


@router.post(
    "",
    status_code=201,
    response_model=FitDocument,
    summary="Fit a measurement",
    responses=openapi.submitted()
    | openapi.problems(
        "bad-encoding",
        "not-found",
        "measurement-too-large",
        "unsupported-media-type",
        "measurement-format",
        "queue-full",
        "disk-full",
    ),
    openapi_extra=openapi.fit_submission(),
)
async def submit_fit(request: Request) -> Response:
    """Fit the MERL file that is the body, or a stored measurement.

    Answers when the fit has ended: 201, or 200 if the same request was made before. A fit that failed is
    such an answer too: its `status` is `failed` and its `error` says why. If the fit takes longer than
    `Prefer: wait=N` seconds (default 30), or with `Prefer: respond-async`, the answer is 202 and
    `Location` tells where to ask again.
    """
    context = context_of(request)
    media_type = request.headers.get("content-type", _RAW).partition(";")[0].strip().lower()
    if media_type == _RAW:
        options = parse_query(request.query_params.multi_items())
        with context.metrics.timing("upload"):
            row, _ = await receive_measurement(request, context.store)
        measurement = row.sha256
    elif media_type == "application/json":
        measurement, options = await _stored_submission(request)
    else:
        detail = f"The content type {media_type[:60]!r} is not supported; send a MERL file as {_RAW}, or JSON."
        raise ProblemError("unsupported-media-type", detail, {"Accept-Post": f"{_RAW}, application/json"})
    fit, new = await _submit(context, caller_of(request), measurement, options)
    wait = preferred_wait(request, context.settings.default_wait, context.settings.max_wait)
    return await _answer(request, fit, new, wait)


@router.get(
    "",
    response_model=FitList,
    summary="List the fits",
    responses=openapi.example(examples.FIT_LIST, "Fits, newest first.") | openapi.problems("invalid-argument"),
)
async def list_fits(request: Request, page: Annotated[Page, Query()]) -> Response:
    """Return a page of fits, newest first; `Link` with `rel="next"` leads to the next one."""
    context = context_of(request)
    before = None if page.cursor is None else int(page.cursor)
    rows = await run_in_threadpool(context.store.fits, owner_of(request), page.limit, before)
    items = [fit_summary(row, context.jobs.progress(row)) for row in rows]
    headers = next_page(request, page.limit, len(rows), rows[-1].seq if rows else None)
    return json_reply(FitList(items=items), headers=headers)


@router.get(
    "/{fit_id}",
    response_model=FitDocument,
    summary="Look a fit up",
    responses=openapi.example(examples.FIT, "The fit.") | openapi.problems("not-found", "invalid-argument"),
)
async def get_fit(request: Request, fit_id: FitId, waiting: Annotated[Waiting, Query()]) -> Response:
    """Return a fit; with `wait`, when it has ended or the time is over."""
    context = context_of(request)
    row = await _wait(request, fit_of(request, fit_id), min(waiting.wait, context.settings.max_wait))
    if row is None:
        raise no_such_fit(fit_id)
    document = await _document(context, row)
    headers = {} if row.ended else {"Retry-After": "1"}
    return tagged_reply(request, document.model_dump_json().encode(), headers=headers)


@router.delete(
    "/{fit_id}",
    response_model=FitDocument,
    summary="Cancel or delete a fit",
    responses=openapi.example(examples.CANCELLED_FIT, "The fit was unfinished and is cancelled.")
    | {204: {"description": "The fit had ended and is deleted."}}
    | openapi.problems("not-found"),
)
async def delete_fit(request: Request, fit_id: FitId) -> Response:
    """Cancel an unfinished fit (200, it stays in the list), or delete one that has ended (204)."""
    context = context_of(request)
    fit = fit_of(request, fit_id)
    row = await context.jobs.cancel(fit)
    if row is not None:
        return json_reply(await _document(context, row))
    if not await run_in_threadpool(context.store.remove_fit, fit):
        raise no_such_fit(fit_id)
    context.models.forget(fit)
    return Response(status_code=204)


async def _known_fit(request: Request, fit_id: FitId) -> FitKey:
    """Look the fit up before the stream begins, while the answer can still be 404."""
    fit = fit_of(request, fit_id)
    if await run_in_threadpool(context_of(request).store.fit, fit) is None:
        raise no_such_fit(fit_id)
    return fit


@router.get(
    "/{fit_id}/events",
    response_class=EventSourceResponse,
    summary="Follow a fit",
    responses=openapi.events() | openapi.problems("not-found"),
)
async def follow_fit(request: Request, fit: Annotated[FitKey, Depends(_known_fit)]) -> AsyncIterable[ServerSentEvent]:
    """Send an event at every step of a fit; the event's name is the fit's status, the last one tells its end."""
    context = context_of(request)
    with context.metrics.event_streams.track_inprogress():
        async for row in context.jobs.watch(fit):
            event: Progress = fit_progress(row, context.jobs.progress(row))
            yield ServerSentEvent(data=event, event=row.status)


async def _stored_submission(request: Request) -> tuple[str, FitOptions]:
    """Return measurement and options of a JSON body."""
    if request.query_params:
        raise InvalidArgumentError("With a JSON body the options belong into its member 'options', not into the query.")
    body = bytes(await receive_small(request, _LARGEST_JSON))
    try:
        document = FitRequest.model_validate_json(body)
    except ValidationError as error:
        raise InvalidArgumentError(sentence(error.errors())) from None
    return document.measurement, parse_options(document.options)


async def _submit(context: Context, caller: Caller, measurement: str, options: FitOptions) -> tuple[FitRow, bool]:
    try:
        return await context.jobs.submit(caller, measurement, options)
    except MissingMeasurementError:
        raise no_such_measurement(measurement) from None
    except (QueueQuotaError, StorageQuotaError) as error:
        raise over_quota(error) from None
    except QueueFullError:
        limit = context.settings.queue_limit
        detail = f"{limit} fits are waiting already, as many as may; the measurement is stored, ask again later."
        raise ProblemError("queue-full", detail, {"Retry-After": "10"}) from None


async def _wait(request: Request, key: FitKey, seconds: float) -> FitRow | None:
    """Return the fit's row when it has ended or after `seconds`; at once if the client goes, which frees its place."""
    jobs = context_of(request).jobs
    if not seconds:
        return await jobs.wait(key, 0)
    gone = asyncio.create_task(_departure(request))
    try:
        return await jobs.wait(key, seconds, gone)
    finally:
        gone.cancel()


async def _departure(request: Request) -> None:
    """Return when the client has closed the connection."""
    with suppress(ProblemError):  # of a body that nobody wants and that comes too slowly
        while (await request.receive())["type"] != "http.disconnect":
            pass


async def _answer(request: Request, fit: FitRow, new: bool, wait: float) -> Response:
    """Return the fit when it has ended, or after `wait` seconds."""
    context = context_of(request)
    row = fit if fit.ended else await _wait(request, fit.key, wait)
    if row is None:  # deleted meanwhile by someone else
        raise no_such_fit(fit.id)
    headers = {"Location": f"/v1/fits/{row.id}"}
    document = await _document(context, row)
    if row.ended:
        return json_reply(document, 201 if new else 200, headers)
    return json_reply(document, 202, {**headers, "Retry-After": "1"})


async def _document(context: Context, row: FitRow) -> FitDocument:
    model = (await context.models.get(row.key)).model if row.status == "succeeded" else None
    return fit_document(row, context.jobs.progress(row), model)
