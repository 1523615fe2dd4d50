"""Sphinx extension: search shows excerpts also where the pages are opened from a disk, and no script may read them.

The text of all pages is written as one script, which the search page loads there only.
"""

import json
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

_ARTICLE = re.compile(r"<article\b.*?</article>", re.DOTALL)
_NOT_TEXT = re.compile(r"<(script|style|svg|math)\b.*?</\1>|<img\b[^>]*>", re.DOTALL)


def add_script(app: Sphinx, pagename: str, _template: str, _context: dict[str, Any], _doctree: object) -> None:
    """Load the script on the search page."""
    if pagename == "search":
        app.add_js_file("search_from_disk.js")


def write_texts(app: Sphinx, failure: Exception | None) -> None:
    """Write the articles of all pages, without pictures and formulas, as a script."""
    if failure is None:
        folder = Path(app.outdir)
        pages = {file.relative_to(folder).as_posix(): _article(file) for file in sorted(folder.rglob("*.html"))}
        (folder / "_static" / "search_pages.js").write_text(f"const searchPages = {json.dumps(pages)};\n")


def _article(file: Path) -> str:
    found = _ARTICLE.search(file.read_text(encoding="utf-8"))
    return f'<div role="main">{_NOT_TEXT.sub("", found[0])}</div>' if found else ""


def setup(app: Sphinx) -> dict[str, bool]:
    """Take part in the building of pages."""
    app.connect("html-page-context", add_script)
    app.connect("build-finished", write_texts)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
