"""Rows of the store's tables as frozen dataclasses; times are seconds since 1970."""

import json
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

Status = Literal["accepted", "running", "succeeded", "failed", "cancelled"]
UNFINISHED: tuple[Status, ...] = ("accepted", "running")
_REPEATABLE = ("compute", "system")  # origins of a failure after which the same request runs again


@dataclass(frozen=True)
class MeasurementRow:
    """A stored measurement."""

    COLUMNS: ClassVar[str] = "seq, sha256, size, valid_nodes, created"

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
    """A fit's state without its result; options as on the wire."""

    COLUMNS: ClassVar[str] = (
        "seq, id, measurement, status, attempts, created, started, finished,"
        " options, algorithm, library, metrics, error"
    )

    seq: int
    id: str
    measurement: str
    status: Status
    attempts: int
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
    def ended(self) -> bool:
        """Whether the fit is over, well or not."""
        return self.status not in UNFINISHED

    @property
    def repeatable(self) -> bool:
        """Whether the same request computes it once more."""
        failed_otherwise = self.error is not None and self.error["origin"] in _REPEATABLE
        return self.status == "cancelled" or failed_otherwise
