"""The application: `create_app` puts the parts together, and the lifespan opens and closes them."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.types import ASGIApp

import dsbrdf
from dsbrdf.data.merl import MerlChecker
from service.access.authentication import Gate
from service.access.changes import follow
from service.access.keys import Keys
from service.context import Context
from service.http import contract, problems
from service.jobs.engine_factory import engine_of
from service.jobs.jobs import Jobs
from service.jobs.model_cache import Models
from service.operations.metrics import Metrics
from service.operations.readiness import Readiness
from service.operations.request_log import Observe
from service.routes import brdf, docs, exports, fits, health, lobes, measurements
from service.settings import Settings
from service.storage.store import Store

_DESCRIPTION = """Fits the Directional Statistics BRDF model to measurements in the MERL format.

`POST /v1/fits` with a file as the body answers with the fitted model; the fit then gives BRDF values and its
decomposition into specular spike, specular lobe and diffuse part. Angles are in degrees, directions are unit
vectors about the normal (0, 0, 1), values are in 1/sr, in the order red, green, blue. Errors are RFC 9457
problem documents.
"""


class _Application(FastAPI):
    """FastAPI with a layer around everything, so that also an error that nothing has foreseen is observed."""

    def build_middleware_stack(self) -> ASGIApp:
        """Return the layers of the application."""
        state = self.state
        guarded = Gate(super().build_middleware_stack(), state.settings, state.keys)
        return Observe(guarded, state.settings, state.metrics)


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Open what the service works with, and close it in the opposite order."""
    settings, metrics, keys = app.state.settings, app.state.metrics, app.state.keys
    store = app.state.store or await run_in_threadpool(Store, settings.data_dir)
    try:
        engine = engine_of(settings)
        jobs = Jobs(store, engine, settings, metrics)
        models = Models(store, settings.model_cache)
        await run_in_threadpool(keys.load, store.database)
        readiness = Readiness(store, engine, settings)
        app.state.context = Context(settings, store, engine, jobs, models, metrics, readiness)
        metrics.collect_from(store.database)
        await run_in_threadpool(MerlChecker)  # what uploads share is made before the first one
        await engine.start()
        await jobs.start()
        following = asyncio.create_task(follow(store.database, keys, models))
        try:
            yield
        finally:
            following.cancel()
            with suppress(asyncio.CancelledError):
                await following
            await jobs.close()
            await engine.close()
    finally:
        store.close()


def create_app(settings: Settings, store: Store | None = None) -> FastAPI:
    """Return the application for `settings`.

    It takes over `store`, which is the one of its data folder; without one, nothing is opened before it starts.
    """
    app = _Application(
        title="dsbrdf",
        version=dsbrdf.__version__,
        description=_DESCRIPTION,
        lifespan=_lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,  # every resource has one name
        generate_unique_id_function=contract.operation_id,
    )
    app.state.settings, app.state.store = settings, store
    app.state.metrics, app.state.keys = Metrics(), Keys(settings)
    problems.install(app)
    # Routes are tried in this order, so the ones that have to be quick come first.
    for routes in (brdf, fits, lobes, exports, measurements, health, docs):
        app.include_router(routes.router)
    contract.install(app)
    return app
