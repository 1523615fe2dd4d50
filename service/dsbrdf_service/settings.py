"""Define the settings of the service, from the environment (prefix ``DSBRDF_``) or the command line."""

import ipaddress
from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from dsbrdf.engines.engine import MIN_FIT_MEMORY_MB
from dsbrdf.process_settings import core_count

from . import DEFAULT_DATA_DIR

PREFIX = "DSBRDF_"
_MAX_LIMIT = 10**12  # The database cannot store any greater limit.


class Settings(BaseSettings):
    """Hold the settings of one service; the environment variable of ``data_dir`` is ``DSBRDF_DATA_DIR``, and so on."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_ignore_empty=True, frozen=True)

    host: str = Field(default="127.0.0.1", description="Address to listen on.")
    port: int = Field(default=8000, ge=0, le=65535, description="Port to listen on; 0 selects a free port.")
    data_dir: Path = Field(default=Path(DEFAULT_DATA_DIR), description="Folder of the database and the measurements.")
    insecure: bool = Field(default=False, description="Allow an address other than loopback without API keys.")
    require_keys: bool = Field(default=False, description="Require API keys on loopback too, as behind a proxy.")
    key_requests_per_second: float = Field(
        default=100.0, ge=0.001, description="Maximum rate of requests with one API key."
    )
    key_stored_mb: int = Field(
        default=10_000, ge=0, lt=_MAX_LIMIT, description="Maximum size of data stored with one API key [MB]."
    )
    key_queued_fits: int = Field(
        default=100, ge=0, lt=_MAX_LIMIT, description="Maximum number of unfinished fits of one API key."
    )

    log_level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="Lowest level of log lines; debug also logs successful GET and HEAD requests."
    )

    engine: Literal["local", "dask"] = Field(
        default="local", description="Where fits run: on this machine or on a Dask cluster."
    )
    scheduler: str = Field(
        default="tcp://127.0.0.1:8786",
        pattern=r"^(tcp|tls|ws|wss)://[^/\s]+$",
        description="Address of the Dask scheduler; without TLS, anyone who can reach it can run code on its workers.",
    )
    workers: int = Field(
        default_factory=core_count,
        ge=1,
        le=1024,
        description="Number of fits that run at once; with Dask, that are sent to the cluster at once.",
    )
    queue_limit: int = Field(
        default=1000, ge=1, description="Maximum number of waiting fits; beyond it, requests get 503."
    )
    fit_seconds: float = Field(default=600.0, gt=0, le=10**9, description="Time limit of one fit [s].")
    fit_memory_mb: int = Field(
        default=4096, ge=MIN_FIT_MEMORY_MB, le=10**9, description="Address space limit of one fit's process [MB]."
    )
    fit_attempts: int = Field(
        default=2,
        ge=1,
        description="Maximum number of attempts if the process of a fit is lost; restarts of the service do not count.",
    )

    default_wait: float = Field(default=30.0, ge=0, description="Time that a POST waits for its fit by default [s].")
    max_wait: float = Field(default=300.0, ge=0, description="Maximum time that any request may wait [s].")
    model_cache: int = Field(default=256, ge=1, description="Number of models in the cache for evaluation.")
    min_free_mb: int = Field(
        default=256, ge=0, description="Free disk space below which the service is not ready [MB]."
    )

    limit_concurrency: int = Field(
        default=512, ge=1, description="Maximum number of requests in progress; beyond it, requests get 503."
    )
    idle_timeout: float = Field(
        default=30.0, gt=0, description="An upload is aborted after this time without data [s]."
    )
    least_upload_rate: int = Field(
        default=10_000, ge=0, description="An upload with a lower mean rate is aborted [bytes/s]; 0 allows any rate."
    )
    shutdown_seconds: int = Field(
        default=4, ge=1, le=3600, description="Time for requests in progress to finish at shutdown [s]."
    )

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the address."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False
