"""Define the dependencies of routes: the parts of the running service, the caller, and common parameters."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Path, Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.samples.table_options import TableOptions

from ..access import CALLER, Keys
from ..compute.computations import Computations, LoadedFit, ModelCache
from ..compute.steps import StoredMeasurement
from ..errors import ProblemError
from ..http.messages import Bodies
from ..http.monitoring import Metrics, Readiness
from ..http.openapi import EXAMPLE_FIT, EXAMPLE_SHA256
from ..queue import FitQueue
from ..settings import Settings
from ..storage.files import in_thread
from ..storage.schema import Caller, FitKey, FitRow
from ..storage.store import Store
from ..wire import table_from_query
from .fields import FIT_ID, SHA256


@dataclass(frozen=True)
class Context:
    """The parts of one service, which are opened when the service starts and closed when it stops."""

    settings: Settings
    store: Store
    queue: FitQueue
    models: ModelCache
    keys: Keys
    metrics: Metrics
    readiness: Readiness
    computations: Computations
    bodies: Bodies

    async def in_process(self, request: Request, step: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Call `Computations.run_in_process`, and raise its errors.

        Raises MeasurementNotFoundError if a measurement among the arguments is deleted during the computation.
        """
        try:
            return await self.computations.run_in_process(request, step, *arguments, **named)
        except ProblemError:
            for stored in arguments:
                if isinstance(stored, StoredMeasurement):
                    await in_thread(self.store.measurement_file, request.scope[CALLER].owner, stored.sha256)
            raise

    async def stored_measurement(
        self, owner: str, sha256: str, name: str | None = None, *, on_grid: bool | None = True
    ) -> StoredMeasurement:
        """Check the file of a stored measurement, on a grid or not, and return its path and name.

        Raises the errors of `Store.measurement_file`, and ProblemError if the measurement is not of this kind.
        """
        row, path = await in_thread(self.store.measurement_file, owner, sha256)
        if on_grid in (None, row.on_grid):
            return StoredMeasurement(path, sha256, name)
        detail = "The measurement is a table of samples, without pictures or values in between; fit it first."
        if row.on_grid:
            detail = "The measurement is a grid, not a table of samples; read its content instead."
        raise ProblemError("not-found", detail)


async def context_of(request: Request) -> Context:
    """Return the service that answers `request`."""
    context: Context = request.app.state.context
    return context


async def caller_of(request: Request) -> Caller:
    """Return the sender of a request, with the sender's limits."""
    caller: Caller = request.scope[CALLER]
    return caller


TheContext = Annotated[Context, Depends(context_of)]
TheCaller = Annotated[Caller, Depends(caller_of)]
FitId = Annotated[str, Path(pattern=FIT_ID, description="The fit's id.", examples=[EXAMPLE_FIT])]
Sha256 = Annotated[str, Path(pattern=SHA256, description="The sha256 of the file's bytes.", examples=[EXAMPLE_SHA256])]


async def fit_key(caller: TheCaller, fit_id: FitId) -> FitKey:
    """Return the key of the caller's fit `fit_id`, which need not exist."""
    return FitKey(caller.owner, fit_id)


TheFit = Annotated[FitKey, Depends(fit_key)]


async def _fit_row(context: TheContext, fit: TheFit) -> FitRow:
    return await run_in_threadpool(context.store.fit, fit)


async def _loaded_fit(context: TheContext, fit: TheFit) -> LoadedFit:
    return await context.models.get(fit)


async def _measurement(context: TheContext, caller: TheCaller, sha256: Sha256) -> StoredMeasurement:
    return await context.stored_measurement(caller.owner, sha256)


TheRow = Annotated[FitRow, Depends(_fit_row)]
TheLoadedFit = Annotated[LoadedFit, Depends(_loaded_fit)]
TheMeasurement = Annotated[StoredMeasurement, Depends(_measurement)]


async def _table_options_in(request: Request) -> TableOptions:
    return table_from_query(request.query_params.multi_items())


TheTableOptions = Annotated[TableOptions, Depends(_table_options_in)]


async def check_query(request: Request) -> None:
    """Refuse query parameters that the route does not declare, or that are given twice, instead of ignoring them."""
    if not request.scope["query_string"]:
        return
    route: APIRoute = request.scope["route"]
    written = (route.openapi_extra or {}).get("parameters", ())
    declared = [parameter["name"] for parameter in written if parameter["in"] == "query"]
    for field in route.dependant.query_params:
        declared += getattr(field.field_info.annotation, "model_fields", [field.alias])
    for name, count in Counter(name for name, _ in request.query_params.multi_items()).items():
        if name not in declared:
            there_is = f"known is {', '.join(declared)}" if declared else "there is none here"
            raise InvalidArgumentError(f"Unknown query parameter {name[:60]!r}; {there_is}.")
        if count > 1:
            raise InvalidArgumentError(f"The query parameter {name[:60]!r} is given more than once; give it once.")


CHECKED_QUERY = [Depends(check_query)]
