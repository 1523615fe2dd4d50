"""Give every caller the fits of measured materials that come with the library; they have no rows."""

import hashlib
from functools import cache

import dsbrdf
from dsbrdf.engines.local import document_of
from dsbrdf.output.atlas import FOLDER

from .schema import FitKey, FitRow


def _digest_of(name: str) -> str:
    return hashlib.sha256(f"material {name}".encode()).hexdigest()


ATLAS = {_digest_of(name)[:32]: name for name in dsbrdf.materials()}
"""Names of the materials by the ids of their fits."""


def atlas_row(key: FitKey) -> FitRow:
    """Return the row of a material's fit, as if the caller had made it; it was never started here."""
    name = ATLAS[key.id]
    metrics, made = dsbrdf.load_material(name).report.metrics.__dict__, (FOLDER / f"{name}.json").stat().st_mtime
    return FitRow(
        owner=key.owner,
        seq=0,
        name=name,
        id=key.id,
        measurement=_digest_of(name),
        status="succeeded",
        attempts=0,
        created=made,
        started=None,
        finished=made,
        options={},
        algorithm=str(dsbrdf.ALGORITHM_VERSION),
        library=dsbrdf.__version__,
        metrics=dict(metrics),
        error=None,
    )


@cache
def atlas_result(fit_id: str) -> bytes:
    """Return the document of a material's fit; its components take 0.2 s when they are first asked for."""
    return document_of(dsbrdf.load_material(ATLAS[fit_id])).text.encode()
