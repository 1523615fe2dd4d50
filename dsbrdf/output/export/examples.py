"""Write an example beside an exported file: a scene, a page or a script that shows the material on a sphere.

In the template of an example, ``FILE`` stands for the name of the exported file, and ``SELF`` for the name of the
example. All examples have a similar sphere and similar lights.
"""

from html import escape
from json import dumps
from pathlib import Path

from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.output.export.templates import filled, template

EXAMPLES = {
    "glsl": (".html", "three.html"),
    "bsdf": (".xml", "mitsuba.xml"),
    "bsdf-spectral": (".pbrt", "scene.pbrt"),
    "materialx": ("_blender.py", "blender.txt"),
}
"""For each exported format that has an example: the end of the example's file name, and the example's template."""


def example(path: Path, file_format: str, content: bytes, name: str) -> tuple[Path, bytes]:
    """Return the path and the text of an example that shows an exported file; `name` is the GLSL function in the file.

    Raises InvalidArgumentError if the format has no example.
    """
    if file_format not in EXAMPLES:
        raise InvalidArgumentError(f"there is an example for {one_of(list(EXAMPLES))}, not for {file_format}")
    end, file = EXAMPLES[file_format]
    beside = path.with_name(path.stem + end)
    words = {"SELF": beside.name, "STEM": path.stem, "FILE": path.name}
    quoted = {word: escape(one) if end in (".html", ".xml") else dumps(one)[1:-1] for word, one in words.items()}
    shader = content.decode() if file_format == "glsl" else ""
    return beside, filled(template(file), quoted | {"FUNCTION": name, "SHADER": shader}).encode()
