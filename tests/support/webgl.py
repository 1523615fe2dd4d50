"""GLSL functions evaluated by WebGL 2 in a headless Chromium, with its software renderer."""

import base64
import json
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dsbrdf.arrays import Array

CHROMIUM = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "google-chrome"))), None)
"""Path of the browser, or None. Without the windows of the others, the first opens a page in a fifth of their time."""
SOFTWARE_RENDERER = ("--use-angle=swiftshader-webgl", "--enable-unsafe-swiftshader")
"""Arguments with which the browser runs WebGL without a graphics card, and draws the rest of a page without WebGL."""
_TIMEOUT = 600.0  # seconds; a page takes about 2 on a quiet machine


@dataclass(frozen=True, eq=False)
class ShaderCall:
    """A GLSL expression of two vectors, and the vectors."""

    source: str  # functions
    call: str  # an expression of `a` and `b`, the vectors, of type vec3
    first: Array  # (n, 3)
    second: Array
    precision: str = "precision highp float; precision highp int;"

    def document(self) -> dict[str, object]:
        rows = -(-len(self.first) // 128)
        shader = f"""#version 300 es
uniform highp sampler2D first, second;
out highp vec4 colour;
{self.precision}
{self.source}
void main() {{
  vec3 a = texelFetch(first, ivec2(gl_FragCoord.xy), 0).xyz, b = texelFetch(second, ivec2(gl_FragCoord.xy), 0).xyz;
  colour = vec4({self.call}, 1.0);
}}"""
        encoded: dict[str, object] = {"shader": shader, "rows": rows}
        for name, vectors in (("first", self.first), ("second", self.second)):
            padded = np.zeros((128 * rows, 4), dtype="<f4")
            padded[: len(vectors), :3] = vectors
            encoded[name] = base64.b64encode(padded.tobytes()).decode()
        return encoded


def evaluate_glsl(calls: Mapping[str, ShaderCall], folder: Path) -> dict[str, Array]:
    """Values (n, 3) of GLSL expressions, compiled and run by one browser in single precision; the page is in `folder`.

    Raises RuntimeError with the compiler's messages.
    """
    pixels = [np.frombuffer(base64.b64decode(text), dtype="<f4") for text in page_answers(calls, folder, 0)]
    pairs = zip(calls.items(), pixels, strict=True)
    return {name: found.reshape(-1, 4)[: len(call.first), :3].astype(float) for (name, call), found in pairs}


def page_answers(calls: Mapping[str, ShaderCall], folder: Path, repeats: int) -> list[str]:
    """What the page gives for each call: values in base64 or, for repeats above 0, the shortest time [ms]."""
    assert CHROMIUM is not None
    page = folder / "page.html"
    text = Path(__file__).with_name("webgl.html").read_text().replace("REPEATS", str(repeats))
    page.write_text(text.replace("INPUTS", json.dumps([call.document() for call in calls.values()])))
    flags = ("--headless", "--no-sandbox", "--disable-dev-shm-usage", f"--user-data-dir={folder / 'profile'}")
    command = [CHROMIUM, *flags, *SOFTWARE_RENDERER, "--dump-dom", page.as_uri()]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT, check=True)
    found: list[str] = re.findall(r"<div>DATA ([\w+/=.]+)</div>", answer.stdout)
    if len(found) != len(calls):
        raise RuntimeError("".join(re.findall(r"FAILED [^<]*", answer.stdout)) + answer.stderr[-2000:])
    return found
