"""Checks the links of built pages: files and anchors must exist, and nothing may be loaded from another host."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "audio": "src"}
_FROM_ELSEWHERE = re.compile(r"""(?:url\(\s*|@import\s+)["']?(?:https?:)?//""")


@dataclass
class Page:
    """What a page links to, what it loads, and the anchors in it."""

    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.page = Page()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.page.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.page.links.append(given["href"])
        elif tag == "link" and given.get("rel") not in ("canonical", "next", "prev", "index", "search", "author"):
            self.page.loaded.append(given.get("href", ""))
        elif _LOADED.get(tag, "") in given:
            self.page.loaded.append(given[_LOADED[tag]])


def read_pages(folder: Path) -> dict[Path, Page]:
    """Return the pages below a folder by their files."""
    pages = {}
    for file in sorted(folder.rglob("*.html")):
        if "_static" not in file.relative_to(folder).parts:
            reader = _Reader()
            reader.feed(file.read_text(encoding="utf-8"))
            pages[file.resolve()] = reader.page
    return pages


def faults(folder: Path, pages: Mapping[Path, Page]) -> list[str]:
    """Return a sentence for each link that leads nowhere and for each file that is loaded from another host."""
    found = []
    for file, page in pages.items():
        name = file.relative_to(folder.resolve())
        found += [f"{name} loads {address} from another host" for address in page.loaded if _is_external(address)]
        inside = [address for address in page.links + page.loaded if not _is_external(address)]
        found += [
            f"{name} links to {address}, which is not there" for address in inside if not _leads(file, address, pages)
        ]
    styles = [style for style in folder.rglob("*.css") if _FROM_ELSEWHERE.search(style.read_text(encoding="utf-8"))]
    found += [f"{style.relative_to(folder)} loads a file from another host" for style in styles]
    return found


def external(pages: Mapping[Path, Page]) -> list[str]:
    """Return the addresses on other hosts that pages link to."""
    return sorted({address for page in pages.values() for address in page.links if _is_external(address)})


def _is_external(address: str) -> bool:
    parts = urlsplit(address)
    return bool(parts.netloc) or parts.scheme == "mailto"


def _leads(file: Path, address: str, pages: Mapping[Path, Page]) -> bool:
    """Whether there is what an address in a file names."""
    parts = urlsplit(address)
    if parts.scheme:  # data:
        return True
    target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
    if target.is_dir():
        target /= "index.html"
    anchor = unquote(parts.fragment)
    if target not in pages:
        return target.is_file() and not anchor
    return anchor in pages[target].anchors or anchor in ("", "top")
