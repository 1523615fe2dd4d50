"""An export in a process of its own, for what takes long."""

from dsbrdf.engines.engine import OnProgress
from dsbrdf.fitting.decomposition import Component
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import export_model


def export_step(model: DSBRDF | Component, file_format: str, _: OnProgress) -> bytes:
    """Return the content of a file with a model, as `export_model` does; a step for `WorkerProcess`."""
    return export_model(model, file_format)
