"""The engine that the settings ask for."""

from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, FitLimits
from dsbrdf.engines.local import LocalEngine
from service.settings import Settings


def engine_of(settings: Settings) -> Engine:
    """Return the engine, which is still to be started.

    Raises
    ------
    MissingExtraError
        If it needs what is not installed.
    """
    limits = FitLimits(settings.fit_seconds, settings.fit_memory_mb)
    if settings.engine == "dask":
        return DaskEngine(settings.scheduler, settings.workers, limits)
    return LocalEngine(settings.workers, limits)
