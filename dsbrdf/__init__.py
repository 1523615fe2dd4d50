"""Directional Statistics BRDF models of measured reflectance (Nishino, ICCV 2009).

    measurement = dsbrdf.read_merl("nickel.binary")
    result = dsbrdf.fit(measurement)
    result.model.evaluate(theta_half, theta_diff)
    dsbrdf.decompose(result.model).diffuse

Angles are in radians unless the name ends in `_deg`, BRDF values in 1/sr, channels in the order red, green, blue.

Subpackages and modules, each importing only those to its left: arrays, errors, findings, version, extras,
process_settings, notebook_display, data, model, rendering, fitting, paper, components, samples, result, pipeline,
output, engines, cli.
"""

from importlib import import_module

from dsbrdf.notebook_display import register as _register_with_notebook

# The stub `__init__.pyi`, which type checkers read, lists the public names, each imported when it is first used.
# Therefore `import dsbrdf` and the commands that compute nothing do not wait for NumPy and SciPy.
with open(f"{__file__}i", encoding="utf-8") as _stub:  # noqa: PTH123 (pathlib takes long to import)
    _MODULE_OF = {line.split()[3]: line.split()[1] for line in _stub if line.startswith("from ")}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__


_register_with_notebook()
