"""Define the settings of the service, from the environment (prefix ``DSBRDF_``) or the command line."""

import ipaddress
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from dsbrdf.engines.engine import MIN_FIT_MEMORY_MB
from dsbrdf.process_settings import core_count

from . import DEFAULT_DATA_DIR

PREFIX = "DSBRDF_"
_MAX_LIMIT = 10**12  # A much larger setting could neither be stored nor be converted to a float.


class Settings(BaseSettings):
    """The settings of one service; the environment variable of ``data_dir`` is ``DSBRDF_DATA_DIR``, and so on."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_ignore_empty=True, frozen=True, use_attribute_docstrings=True
    )

    host: str = "127.0.0.1"
    """Address to listen on."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    """Port to listen on; 0 selects a free port."""
    data_dir: Path = Path(DEFAULT_DATA_DIR)
    """Folder of the database and the measurements."""
    insecure: bool = False
    """Allow an address other than loopback without API keys."""
    require_keys: bool = False
    """Require API keys on loopback too, as behind a proxy."""
    key_requests_per_second: Annotated[float, Field(ge=0.001)] = 100.0
    """Maximum rate of requests with one API key."""
    key_stored_mb: Annotated[int, Field(ge=0, lt=_MAX_LIMIT)] = 10_000
    """Maximum size of data stored with one API key [MB]."""
    key_queued_fits: Annotated[int, Field(ge=0, lt=_MAX_LIMIT)] = 100
    """Maximum number of unfinished fits of one API key."""

    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """Lowest level of log lines; debug also logs successful GET and HEAD requests."""

    engine: Literal["local", "dask"] = "local"
    """Where fits run: on this machine or on a Dask cluster."""
    scheduler: Annotated[str, Field(pattern=r"^(tcp|tls|ws|wss)://[^/\s]+$")] = "tcp://127.0.0.1:8786"
    """Address of the Dask scheduler; without TLS, anyone who can reach it can run code on its workers."""
    workers: int = Field(default_factory=core_count, ge=1, le=1024)
    """Number of fits that run at once; with Dask, that are sent to the cluster at once."""
    queue_limit: Annotated[int, Field(ge=1, lt=_MAX_LIMIT)] = 1000
    """Maximum number of waiting fits; beyond it, requests get 503."""
    fit_seconds: Annotated[float, Field(gt=0, le=10**9)] = 600.0
    """Time limit of one fit [s]."""
    fit_memory_mb: Annotated[int, Field(ge=MIN_FIT_MEMORY_MB, le=10**9)] = 4096
    """Address space limit of one fit's process [MB]."""
    fit_attempts: Annotated[int, Field(ge=1, lt=_MAX_LIMIT)] = 2
    """Maximum number of attempts if the process of a fit is lost; restarts of the service do not count."""

    default_wait_seconds: Annotated[float, Field(ge=0)] = 30.0
    """Time that a POST waits for its fit by default [s]."""
    max_wait_seconds: Annotated[float, Field(ge=0)] = 300.0
    """Maximum time that any request may wait [s]."""
    min_free_mb: Annotated[int, Field(ge=0, lt=_MAX_LIMIT)] = 256
    """Free disk space below which the service is not ready [MB]."""

    limit_concurrency: Annotated[int, Field(ge=1, lt=_MAX_LIMIT)] = 512
    """Maximum number of requests in progress; beyond it, requests get 503."""
    max_idle_seconds: Annotated[float, Field(gt=0)] = 30.0
    """An upload is aborted after this time without data [s]."""
    min_upload_bytes_per_second: Annotated[int, Field(ge=0, lt=_MAX_LIMIT)] = 10_000
    """An upload with a lower mean rate is aborted [bytes/s]; 0 allows any rate."""
    shutdown_seconds: Annotated[int, Field(ge=1, le=3600)] = 4
    """Time for requests in progress to finish at shutdown [s]."""

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the address."""
        with suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"
