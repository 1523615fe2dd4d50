"""The web pages: upload and list, a fit, two fits side by side, signing in with a key, the OpenAPI document."""

import asyncio
import hashlib
from collections import Counter
from collections.abc import Callable, Coroutine
from functools import partial
from importlib.util import find_spec
from typing import Annotated, Any
from urllib.parse import parse_qs, urlencode

import numpy as np
from fastapi import APIRouter, HTTPException, Path, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.layer_shares import LABELS
from dsbrdf.fitting.options import MAX_LOBES
from dsbrdf.model.environment import THREE_LIGHTS
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.output.export import FORMATS
from dsbrdf.output.report_text import likeness, lobes_phrase

from ..access.authentication import COOKIE, from_another_site, keys_in_cookies, same_origin
from ..errors import ProblemError
from ..http.openapi import BINARY
from ..http.pages import PAGE_PATHS, POLICY_WITHOUT_FORMS, STATIC_FILES, render, sign_in_page
from ..http.problems import KINDS, problem_of
from ..http.request_body import receive_body
from ..http.responses import tagged_reply
from ..jobs.results import FitView
from ..jobs.steps import LARGEST_LIGHT, LIGHT_STEP, StoredMeasurement, environment_step, table_step
from ..storage.schema import FitKey, FitRow
from ..wire.schemas import Page, Plain
from .dependencies import NO_REPETITION, Context, TheCaller, TheContext, TheFit
from .figures import PNG, drawn_reply
from .page_text import (
    COMPONENT_MEANINGS,
    FIGURES,
    component_facts,
    facts_of,
    metrics_in_words,
    options_in_words,
)

_MAX_FORM = 1 << 12
_FORM_SECONDS = 5.0  # anyone may send one
_PANORAMA = (128, 256)  # rows and columns, as `panorama.js` sends it
_PANORAMA_BYTES = 12 * _PANORAMA[0] * _PANORAMA[1]


class _PageRoute(APIRoute):
    """A route whose errors are pages too."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handler = super().get_route_handler()

        async def answer(request: Request) -> Response:
            try:
                return await handler(request)
            except (ProblemError, InvalidArgumentError, RequestValidationError) as error:
                problem = problem_of(request, error)
                kind = KINDS[problem.kind]
                return _render("error.html", request, kind.status, title=kind.title, detail=problem.detail)

        return answer


router = APIRouter(include_in_schema=False)
pages = APIRouter(route_class=_PageRoute, include_in_schema=False)


@pages.get("/", dependencies=NO_REPETITION)
async def get_index(
    request: Request, context: TheContext, caller: TheCaller, page: Annotated[Page, Query()]
) -> Response:
    """Return the page to upload a measurement, with the list of fits."""
    name = page.name or None  # an empty field of the search
    rows = await run_in_threadpool(context.store.fits, caller.owner, page.limit + 1, page.before, name)
    shown = rows[: page.limit]
    query = {"name": name} if name else {}
    older = urlencode({**query, "cursor": shown[-1].seq}) if len(rows) > page.limit else ""
    stored = await run_in_threadpool(lambda: [context.store.measurement(row.owner, row.measurement) for row in shown])
    measured = {measurement.sha256 for measurement in stored if measurement is not None and measurement.on_grid}
    names = Counter(row.name for row in shown)
    items = [
        {
            "row": row,
            "facts": facts_of(row),
            "progress": context.jobs.progress(row),
            "options": options_in_words(row.options) if names[row.name] > 1 else "",
        }
        for row in shown
    ]
    return _render(
        "index.html", request, items=items, measured=measured, name=name or "", older=older, max_lobes=MAX_LOBES
    )


@pages.get("/fits/{fit_id}")
async def get_fit_page(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return the page of one fit: its progress, why it failed, or the result."""
    row = await context.fit_row(fit)
    if row.status != "succeeded":
        return _render("unfinished.html", request, row=row, progress=context.jobs.progress(row))
    stored = await run_in_threadpool(context.store.measurement, row.owner, row.measurement)
    measured = stored is not None and stored.on_grid
    model = (await context.models.get(row.key)).model
    return _render(
        "fit.html",
        request,
        downloads=FORMATS,
        figures=FIGURES if measured and find_spec("matplotlib") else {},
        stored=stored is not None,
        largest_light=LARGEST_LIGHT,
        light_step=LIGHT_STEP,
        model=f"{lobes_phrase(model)}, {model.n_numbers} numbers",
        meanings=COMPONENT_MEANINGS,
        **await _shown(context, row),
    )


@pages.get("/compare")
async def get_comparison(
    request: Request, context: TheContext, caller: TheCaller, fits: Annotated[list[str], Query(alias="fit")]
) -> Response:
    """Return the page with two fits side by side."""
    if len(fits) != 2:
        raise InvalidArgumentError(f"Two fits are compared at a time; tick two in the list, not {len(fits)}.")
    rows = [await context.fit_row(FitKey(caller.owner, fit_id)) for fit_id in fits]
    return _render("compare.html", request, sides=[await _shown(context, row) for row in rows])


@router.get("/fits/{fit_id}/view")
async def get_view(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return what the sphere of a page needs: the exposure, the lights, which pictures there are."""
    view = await _view(request, context, fit)
    lights = [{"direction": light.direction, "irradiance": light.irradiance} for light in THREE_LIGHTS]
    return tagged_reply(
        request,
        {"exposure": view.drawn.exposure, "lights": lights, "labels": LABELS, "pictures": [*view.drawn.pictures]},
    )


@router.get("/fits/{fit_id}/spheres/{name}.png")
async def get_sphere(request: Request, context: TheContext, fit: TheFit, name: str) -> Response:
    """Return the picture of a sphere: measured, fit or difference."""
    view = await _view(request, context, fit)
    pictures = view.drawn.pictures
    if name not in pictures:
        raise ProblemError("not-found", f"There is no picture {name[:40]!r}; there is {', '.join(pictures)}.")
    return tagged_reply(request, pictures[name], PNG)


@router.get("/fits/{fit_id}/measured.bin")
async def get_table(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return the measurement of a fit as the texture of its logarithms."""
    stored = await _measurement_of(context, fit)
    return await drawn_reply(request, context, BINARY, ("table", fit.owner, stored.sha256), table_step, stored)


@router.get("/fits/{fit_id}/environment/{name}.bin")
async def get_environment(request: Request, context: TheContext, fit: TheFit, name: str) -> Response:
    """Return the radiance of a sphere under environment light: of the measurement, the fit or a component."""
    source = await _source(context, fit, name)
    return await drawn_reply(request, context, BINARY, ("environment", fit, name), environment_step, source, None)


@router.post("/fits/{fit_id}/environment/{name}.bin")
async def post_environment(request: Request, context: TheContext, fit: TheFit, name: str) -> Response:
    """Return the same under the light of a panorama, whose linear RGB the page has sent."""
    source = await _source(context, fit, name)
    body = await receive_body(request, _PANORAMA_BYTES)
    if len(body) != _PANORAMA_BYTES:
        raise InvalidArgumentError(
            f"A panorama is float32 RGB of {_PANORAMA[0]} rows of {_PANORAMA[1]} pixels here, {_PANORAMA_BYTES} bytes, "
            f"not {len(body)}."
        )
    pixels = np.frombuffer(body, "<f4").reshape(*_PANORAMA, 3)
    key = ("panorama", fit, name, hashlib.sha256(body).digest())
    return await drawn_reply(request, context, BINARY, key, environment_step, source, pixels)


@router.get("/fits/{fit_id}/profiles/{theta_diff_deg}")
async def get_profile(
    request: Request,
    context: TheContext,
    fit: TheFit,
    theta_diff_deg: Annotated[int, Plain, Path(ge=0, le=89)],
) -> Response:
    """Return the measured values, the fit and its components over theta_half, at one theta_diff."""
    view = await _view(request, context, fit)
    key, draw = ("profile", fit, theta_diff_deg), partial(view.profile, theta_diff_deg)
    return tagged_reply(request, await context.computations.run(request, key, draw))


@router.get("/fits/{fit_id}/polar/{theta_in_deg}")
async def get_polar(
    request: Request,
    context: TheContext,
    fit: TheFit,
    theta_in_deg: Annotated[int, Plain, Path(ge=0, le=LARGEST_LIGHT, multiple_of=LIGHT_STEP)],
) -> Response:
    """Return the measured values, the fit and its components in the plane of incidence, for one direction of light."""
    view = await _view(request, context, fit)
    key, draw = ("polar", fit, theta_in_deg), partial(view.plane_of_incidence, theta_in_deg)
    return tagged_reply(request, await context.computations.run(request, key, draw))


@router.get("/docs")
@router.get("/docs/{name}")
@router.get("/page/{name}")
async def get_static(request: Request) -> Response:
    """Return the page that shows the OpenAPI document, or a script, style sheet or picture that the pages load."""
    path = request.scope["path"]
    if path not in STATIC_FILES:
        raise HTTPException(404)
    file, media_type = STATIC_FILES[path]
    headers = {"Content-Security-Policy": POLICY_WITHOUT_FORMS} if path == "/docs" else {}
    return tagged_reply(request, await run_in_threadpool(file.read_bytes), media_type, headers)


@router.get("/sign-in")
async def get_sign_in() -> Response:
    """Return the page to sign in."""
    return sign_in_page("/", "")


@router.post("/sign-in")
async def sign_in(request: Request, context: TheContext) -> Response:
    """Keep a key in a cookie that no script can read, and lead to the page that was wanted."""
    try:
        async with asyncio.timeout(_FORM_SECONDS):
            body = await receive_body(request, _MAX_FORM)
    except TimeoutError:
        detail = f"The form took longer than the {_FORM_SECONDS:g} s that it may take."
        raise ProblemError("request-timeout", detail, {"Connection": "close"}) from None
    form = parse_qs(body.decode("latin-1"))
    key, wanted = (form.get(name, [""])[0].strip() for name in ("key", "wanted"))
    wanted = wanted if PAGE_PATHS.fullmatch(wanted) else "/"
    if not same_origin(request.scope["headers"]):
        return sign_in_page("/", "Signing in works from this page only; please try again.", status=403)
    if context.keys.find(key.encode()) is None:
        return sign_in_page("/", "This is no valid key. It may have been revoked, or a character is missing.")
    secure = "https" in (request.url.scheme, request.headers.get("origin", "").partition(":")[0])
    response = Response(status_code=303, headers={"Location": f".{wanted}"})
    response.set_cookie(COOKIE, key, httponly=True, samesite="strict", secure=secure)
    return response


@router.post("/sign-out")
async def sign_out(request: Request) -> Response:
    """Forget the key of the browser."""
    if from_another_site(request.scope["headers"]):
        raise ProblemError("foreign-origin", "Signing out works from the pages of the service only.")
    response = Response(status_code=303, headers={"Location": "./"})
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return response


def _render(template: str, request: Request, status: int = 200, **values: Any) -> Response:
    return render(
        template, request.url.path, status, signed_in=bool(keys_in_cookies(request.scope["headers"])), **values
    )


async def _view(request: Request, context: Context, fit: FitKey) -> FitView:
    """Return the view of a fit, which is computed once for all who ask for a part of it."""
    return await context.views.get(await context.fit_row(fit), partial(context.in_process, request))


async def _measurement_of(context: Context, fit: FitKey) -> StoredMeasurement:
    row = await context.fit_row(fit)
    return await context.stored_measurement(fit.owner, row.measurement)


async def _source(context: Context, fit: FitKey, name: str) -> ReflectanceModel | StoredMeasurement:
    """Return what is seen on a sphere: the measurement of a fit, the fit or one of its components."""
    if name == "measured":
        return await _measurement_of(context, fit)
    return (await context.models.get(fit)).part(None if name == "fit" else name)


async def _shown(context: Context, row: FitRow) -> dict[str, Any]:
    """Return what a page shows of a fit that has succeeded."""
    loaded, metrics = await context.models.get(row.key), row.metrics or {}
    psnr = metrics.get("psnr")
    return {
        "row": row,
        "facts": facts_of(row),
        "options": options_in_words(row.options),
        "verdict": "how good it is" if psnr is None else likeness(psnr),
        "metrics": metrics_in_words(metrics),
        "warnings": loaded.report.warnings if loaded.report else (),
        "components": [component_facts(component) for component in loaded.components],
    }
