"""Read and fill the templates of exported files, each in a file of its own language."""

import re
from collections.abc import Mapping
from pathlib import Path


def template(file: str) -> str:
    """Return the text of a template for an exported file."""
    return Path(__file__).with_name(file).read_text(encoding="utf-8")


def sections(file: str) -> dict[str, str]:
    """Return the sections of a template by name; each begins with a line such as ``//// angles``."""
    parts = (part.partition("\n") for part in template(file).split("//// ")[1:])
    return {name: text for name, _, text in parts}


def filled(text: str, words: Mapping[str, str | int]) -> str:
    """Return a template in which words in capitals are replaced by values."""
    # One pass keeps words in the values, such as FILE in the name of a file.
    return re.sub("|".join(words), lambda found: str(words[found[0]]), text)
