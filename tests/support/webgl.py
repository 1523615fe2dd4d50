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
_PAGE = """<!doctype html><pre id=out></pre><script>
const width = 128, gl = document.createElement("canvas").getContext("webgl2");
function evaluated(input) {
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) throw "no WebGL 2 with float targets";
  function compile(kind, source) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw gl.getShaderInfoLog(shader);
    return shader;
  }
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, `#version 300 es
  void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, input.shader));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw gl.getProgramInfoLog(program);
  gl.useProgram(program);
  function texture(unit, data) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, input.rows, 0, gl.RGBA, gl.FLOAT, data);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  }
  function floats(text) { return new Float32Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer); }
  texture(0, floats(input.first));
  texture(1, floats(input.second));
  gl.uniform1i(gl.getUniformLocation(program, "first"), 0);
  gl.uniform1i(gl.getUniformLocation(program, "second"), 1);
  const target = gl.createTexture();
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D, target);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, input.rows, 0, gl.RGBA, gl.FLOAT, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, width, input.rows);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  if (REPEATS) {
    const times = [];
    for (let i = 0; i <= REPEATS; ++i) {  // reading a pixel waits for the drawing; the first one compiles
      const start = performance.now();
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, new Float32Array(4));
      times.push(performance.now() - start);
    }
    return Math.min(...times.slice(1)).toFixed(4);
  }
  const pixels = new Float32Array(4 * width * input.rows);
  gl.readPixels(0, 0, width, input.rows, gl.RGBA, gl.FLOAT, pixels);
  let text = "";
  for (const byte of new Uint8Array(pixels.buffer)) text += String.fromCharCode(byte);
  return btoa(text);
}
for (const input of INPUTS) {
  const line = document.createElement("div");
  try { line.textContent = "DATA " + evaluated(input); } catch (error) { line.textContent = "FAILED " + error; }
  document.getElementById("out").append(line);
}
</script>"""


@dataclass(frozen=True, eq=False)
class ShaderCall:
    """A GLSL expression of two vectors, and the vectors."""

    source: str  # functions
    call: str  # an expression of `a` and `b`, the vectors, of type vec3
    first: Array  # (n, 3)
    second: Array
    precision: str = "precision highp float; precision highp int;"

    def document(self) -> dict[str, object]:
        """Return what the page is told."""
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
    values = (np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(-1, 4) for text in _answers(calls, folder, 0))
    return {
        name: pixels[: len(call.first), :3].astype(float)
        for (name, call), pixels in zip(calls.items(), values, strict=True)
    }


def time_glsl(calls: Mapping[str, ShaderCall], folder: Path, repeats: int) -> dict[str, float]:
    """Shortest time of drawing each call several times [ms]; as `evaluate_glsl`."""
    return dict(zip(calls, map(float, _answers(calls, folder, repeats)), strict=True))


def _answers(calls: Mapping[str, ShaderCall], folder: Path, repeats: int) -> list[str]:
    """Text that the page gives for each call: values in base64 or, for repeats above 0, the time."""
    assert CHROMIUM is not None
    page = folder / "page.html"
    text = _PAGE.replace("REPEATS", str(repeats))
    page.write_text(text.replace("INPUTS", json.dumps([call.document() for call in calls.values()])))
    flags = ("--headless", "--no-sandbox", "--disable-dev-shm-usage", f"--user-data-dir={folder / 'profile'}")
    command = [CHROMIUM, *flags, *SOFTWARE_RENDERER, "--dump-dom", page.as_uri()]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT, check=True)
    found: list[str] = re.findall(r"<div>DATA ([\w+/=.]+)</div>", answer.stdout)
    if len(found) != len(calls):
        raise RuntimeError("".join(re.findall(r"FAILED [^<]*", answer.stdout)) + answer.stderr[-2000:])
    return found
