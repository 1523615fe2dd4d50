"""Sphinx extension: before pages are read, writes those that come from the code into the folder ``generated``."""

import json
from pathlib import Path

import reference
from gallery import write_if_changed, write_pictures
from sphinx.application import Sphinx


def write_pages(app: Sphinx) -> None:
    """Write references, gallery and pictures."""
    folder = Path(app.srcdir) / "generated"
    document = reference.openapi_document()
    write_if_changed(folder / "command_line.md", reference.command_line().encode())
    write_if_changed(folder / "http.md", reference.http(document).encode())
    write_if_changed(folder / "openapi.json", json.dumps(document, indent=1).encode())
    write_pictures(folder, Path(app.outdir).parent / "materials")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages when Sphinx starts, before it looks for what to read."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
