"""Rows of the store's tables as frozen dataclasses; times are seconds since 1970."""

import json
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

Status = Literal["accepted", "running", "succeeded", "failed", "cancelled"]
UNFINISHED: tuple[Status, ...] = ("accepted", "running")
_REPEATABLE = ("compute", "system")  # origins of a failure after which the same request runs again


class FitKey(NamedTuple):
    """What names a fit: the same request of two owners has the same id, and makes two fits."""

    owner: str
    id: str

    def __str__(self) -> str:
        return f"{self.owner}/{self.id}" if self.owner else self.id


@dataclass(frozen=True)
class Caller:
    """Who asks, and how much they may have at once.

    Attributes
    ----------
    owner : str
        Id of the key that was sent; '' without one. Rows are seen by their owner only.
    stored_bytes, queued_fits : int or None
        Most bytes stored, and most unfinished fits; None is no bound.
    """

    owner: str = ""
    stored_bytes: int | None = None
    queued_fits: int | None = None


@dataclass(frozen=True)
class MeasurementRow:
    """A stored measurement; `seq` counts the measurements of its owner."""

    COLUMNS: ClassVar[str] = "owner, seq, sha256, size, valid_nodes, created"

    owner: str
    seq: int
    sha256: str
    size: int
    valid_nodes: int
    created: float

    @classmethod
    def of(cls, values: tuple[Any, ...]) -> "MeasurementRow":
        """Make a row of the values of `COLUMNS`."""
        return cls(*values)


@dataclass(frozen=True)
class FitRow:
    """A fit's state without its result; options as on the wire; `seq` counts the fits of its owner.

    `attempts` counts the processes that were begun for it, without those that ended because the service did;
    `interruptions` those that ran when the service broke off.
    """

    COLUMNS: ClassVar[str] = (
        "owner, seq, id, measurement, status, attempts, interruptions, created, started, finished,"
        " options, algorithm, library, metrics, error"
    )

    owner: str
    seq: int
    id: str
    measurement: str
    status: Status
    attempts: int
    interruptions: int
    created: float
    started: float | None
    finished: float | None
    options: dict[str, Any]
    algorithm: str
    library: str
    metrics: dict[str, float | None] | None
    error: dict[str, str] | None

    @classmethod
    def of(cls, values: tuple[Any, ...]) -> "FitRow":
        """Make a row of the values of `COLUMNS`."""
        named = dict(zip(cls.COLUMNS.replace(",", "").split(), values, strict=True))
        for name in ("options", "metrics", "error"):
            named[name] = None if named[name] is None else json.loads(named[name])
        return cls(**named)

    @property
    def key(self) -> FitKey:
        """What names the fit."""
        return FitKey(self.owner, self.id)

    @property
    def ended(self) -> bool:
        """Whether the fit is over, well or not."""
        return self.status not in UNFINISHED

    @property
    def repeatable(self) -> bool:
        """Whether the same request computes it once more."""
        failed_otherwise = self.error is not None and self.error["origin"] in _REPEATABLE
        return self.status == "cancelled" or failed_otherwise
