"""Variants of Mitsuba, without which a test is skipped, and MaterialX: its document, and the GLSL it generates."""

import importlib
import importlib.util
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from types import ModuleType
from typing import Any

import pytest

from dsbrdf.output.export.openpbr import OpenPBR

_OLDEST_LLVM = (17,)
"""Older ones end the process: they do not know the minimum of two floats that drjit asks for."""


def mitsuba_variant(name: str) -> ModuleType:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip('"mitsuba" is not installed')
    module = importlib.import_module("mitsuba")
    if name.startswith("llvm"):
        try:
            module.set_variant(name)
        except ImportError:
            pytest.skip('"LLVM" is not installed')
        if importlib.import_module("drjit").detail.llvm_version() < _OLDEST_LLVM:
            pytest.skip('"LLVM" is not installed in a version that can be used')
    module.set_variant(name)
    return module


def surface_at(module: ModuleType, wi: Any) -> Any:
    """Return a surface seen from a direction, or from many in an array of shape (3, n)."""
    size = 1 if isinstance(wi, list) else wi.shape[1]
    surface = importlib.import_module("drjit").zeros(module.SurfaceInteraction3f, size)
    surface.wi = module.Vector3f(wi)
    return surface


_SHADER = "dsbrdf_surface"


def materialx_document(text: str) -> Any:
    """Return the document that MaterialX makes of a file's text, with its standard library."""
    materialx = importlib.import_module("MaterialX")
    library, document = materialx.createDocument(), materialx.createDocument()
    materialx.loadLibraries(materialx.getDefaultDataLibraryFolders(), materialx.getDefaultDataSearchPath(), library)
    materialx.readFromXmlString(document, text)
    document.setDataLibrary(library)
    return document


def surface_of(document: Any) -> OpenPBR:
    node = document.getNode(_SHADER)
    assert node.getCategory() == "open_pbr_surface"
    values: dict[str, Any] = {}
    for field in fields(OpenPBR):
        value = node.getInput(field.name).getValue()
        values[field.name] = value if isinstance(value, float) else tuple(value)
    return OpenPBR(**values)


def generated_function(*documents: Any) -> str:
    """Return GLSL with ``vec3 reflected(vec3 omega_in, vec3 omega_out, int which)``.

    It is the BRDF of one of the documents as MaterialX generates it: compiling it takes seconds.
    """
    document = documents[0]
    materialx = importlib.import_module("MaterialX")
    shader_module = importlib.import_module("MaterialX.PyMaterialXGenShader")
    generator = importlib.import_module("MaterialX.PyMaterialXGenGlsl").EsslShaderGenerator.create()
    context = shader_module.GenContext(generator)
    context.registerSourceCodeSearchPath(materialx.getDefaultDataSearchPath())
    options = context.getOptions()
    options.hwSpecularEnvironmentMethod = shader_module.HwSpecularEnvironmentMethod.SPECULAR_ENVIRONMENT_NONE
    options.hwMaxActiveLightSources = 1
    light = document.getDataLibrary().getNodeDef("ND_directional_light")
    shader_module.HwShaderGenerator.bindLightShader(light, 1, context)
    source = generator.generate("check", document.getMaterialNodes()[0], context).getSourceCode("pixel")
    declared = document.getDataLibrary().getNodeDef("ND_open_pbr_surface_surfaceshader").getInputs()
    inputs = {one.getName(): one.getValue() for one in declared if one.getType() in ("float", "color3")}
    return _as_function(source, [inputs | asdict(surface_of(document)) for document in documents])


def _as_function(source: str, surfaces: Sequence[Mapping[str, Any]]) -> str:
    source = re.sub(r"#version.*|precision .*;|uniform \w*shader\w* .*", "", source)
    source = "const bool u_refractionTwoSided = false;\n" + source  # used without an environment, but not declared
    source = re.sub(r"^(uniform|in|out) (?=\w)", "", source, flags=re.MULTILINE).replace("void main()", "void shade()")
    assigned = "\n".join(
        f"  if (which == {number}) {_SHADER}_{name} = {value if isinstance(value, float) else f'vec3{tuple(value)}'};"
        for number, inputs in enumerate(surfaces)
        for name, value in inputs.items()
    )
    return (
        source
        + f"""
vec3 reflected(vec3 omega_in, vec3 omega_out, int which) {{
{assigned}
  normalWorld = vec3(0.0, 0.0, 1.0);
  tangentWorld = vec3(1.0, 0.0, 0.0);
  positionWorld = vec3(0.0);
  u_viewPosition = omega_out;
  u_numActiveLightSources = 1;
  u_lightData[0].type = 1;
  u_lightData[0].direction = -omega_in;
  u_lightData[0].color = vec3(1.0);
  u_lightData[0].intensity = 1.0;
  shade();
  return out1.rgb / omega_in.z;
}}
"""
    )
