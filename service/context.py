"""What a request needs of the running service."""

from dataclasses import dataclass

from starlette.requests import Request

from dsbrdf.engines.engine import Engine
from service.jobs.jobs import Jobs
from service.jobs.model_cache import Models
from service.operations.metrics import Metrics
from service.operations.readiness import Readiness
from service.settings import Settings
from service.storage.store import Store


@dataclass(frozen=True)
class Context:
    """The parts of one service; made when it starts, closed when it ends."""

    settings: Settings
    store: Store
    engine: Engine
    jobs: Jobs
    models: Models
    metrics: Metrics
    readiness: Readiness


def context_of(request: Request) -> Context:
    """Return the service that answers `request`."""
    context: Context = request.app.state.context
    return context
