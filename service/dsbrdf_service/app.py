"""Make the application: `create_app` connects its parts, and the lifespan opens and closes these parts."""

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache, partial

from anyio import to_thread
from fastapi import FastAPI
from fastapi.middleware.asyncexitstack import AsyncExitStackMiddleware
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

import dsbrdf
from dsbrdf.data.geometry import nodes_above_horizon
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, FitLimits
from dsbrdf.engines.local import LocalEngine

from .access import Access, Keys
from .api import about, fits, measurements, pictures, results, values
from .api.context import Context
from .api.fits import FitRequest, NewName
from .api.measurements import MeasurementDetails
from .api.points import FORMS
from .compute.computations import Computations, ModelCache
from .http import openapi
from .http.messages import Bodies
from .http.middleware import RequestLogMiddleware
from .http.monitoring import Metrics, Readiness
from .queue import FitQueue
from .settings import Settings
from .storage.store import Store

_REFERENCED: tuple[type[BaseModel], ...] = (FitRequest, NewName, *FORMS, MeasurementDetails)
_MAX_CACHED_MODELS = 256  # They take 30 MB.
_MAX_WORKER_THREADS = 8  # A thread keeps its own heap after its first request, so more threads take more memory.
# These limits suit the longest computation of a request, 15 s of processor time at a lower priority than fits.
_COMPUTATION_TIMEOUT_S = 120.0
_COMPUTATION_PROCESSOR_LIMIT_S = 60.0
_COMPUTATION_NICENESS = 5
_SWITCH_INTERVAL_S = 0.0005  # A busy thread delays the event loop by at most this time, a tenth of Python's default.

_DESCRIPTION = """Fits the Directional Statistics BRDF model to measurements: MERL files, RGL `.bsdf` files and
tables of samples.

`POST /v1/fits` with a file as the body answers with the fitted model; the fit then gives BRDF values and its
decomposition into specular spike, specular lobe and diffuse part. Angles are in degrees, directions are unit
vectors about the normal (0, 0, 1), values are in 1/sr, in the order red, green, blue. Errors are RFC 9457
problem documents; `Retry-After` says when a retry may succeed.

`X-Request-ID` is the id of a request in the answer and in the service's log. Answers with an `ETag` can be validated
with `If-None-Match`; `Link` with `rel="next"` leads to the next page of a list.
"""


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Open the parts of the service, and close them in the opposite order."""
    to_thread.current_default_thread_limiter().total_tokens = _MAX_WORKER_THREADS
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    settings, metrics, keys = app.state.settings, app.state.metrics, app.state.keys
    store: Store = app.state.store or Store(settings.data_dir)
    try:
        engine = make_engine(settings)
        models = ModelCache(store, _MAX_CACHED_MODELS)
        keys.open(store.database)
        readiness = Readiness(store, engine, settings)
        limits = FitLimits(
            _COMPUTATION_TIMEOUT_S, settings.fit_memory_mb, _COMPUTATION_NICENESS, _COMPUTATION_PROCESSOR_LIMIT_S
        )
        computations = Computations(limits, store.writing)
        queue = FitQueue(store, engine, settings, metrics.fit_meters)
        parts = settings, store, queue, models, keys, metrics, readiness, computations, Bodies()
        app.state.context = Context(*parts)
        await run_in_threadpool(nodes_above_horizon)  # This caches the grid's mask before the first upload needs it.
        await queue.start()
        try:
            yield
        finally:
            await queue.close()
            await computations.close()
            await asyncio.to_thread(engine.close)
    finally:
        store.close()


def make_engine(settings: Settings) -> Engine:
    """Return the engine that the settings select, not yet started.

    Raises MissingExtraError if a package that the engine needs is not installed.
    """
    limits = FitLimits(settings.fit_seconds, settings.fit_memory_mb)
    if settings.engine == "dask":
        return DaskEngine(settings.scheduler, settings.workers, limits)
    return LocalEngine(settings.workers, limits)


def create_app(settings: Settings, store: Store | None = None) -> FastAPI:
    """Return the application for `settings`; its lifespan opens the data folder unless the open `store` is given."""
    app = FastAPI(
        title="dsbrdf",
        version=dsbrdf.__version__,
        description=_DESCRIPTION,
        lifespan=_lifespan,
        openapi_url=None,  # `api.about` sends the OpenAPI document.
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,  # Every resource has one path, without a slash at its end.
        telemetry={"tracing": False, "metrics": False, "logs": False},  # The service has its own log and metrics.
    )
    metrics, keys = Metrics(), Keys(settings)
    app.state.settings, app.state.store, app.state.metrics, app.state.keys = settings, store, metrics, keys
    app.openapi = cache(partial(openapi.document_of, app, _REFERENCED))  # type: ignore[method-assign]
    access = Access(settings, keys, metrics.requests_in_progress)
    # This is the complete middleware stack: the usual stack of Starlette and FastAPI would answer errors a second time.
    stack = AsyncExitStackMiddleware(app.router)  # FastAPI's routes need this middleware.
    app.middleware_stack = RequestLogMiddleware(stack, access, settings, metrics)
    # Routes are tried in this order, so the routes with the quickest answers come first.
    of_fits = (values.router, fits.router, fits.materials, results.router, pictures.router)
    routers = (*of_fits, values.measured, measurements.router, about.router, about.page)
    given = [route for router in routers for route in router.routes if isinstance(route, APIRoute)]
    for route in given:
        route.unique_id = route.name  # Generated clients name their functions after this id.
    # The application gets the routes themselves, because an included router would match each request a second time.
    app.router.routes.extend(given)
    return app
