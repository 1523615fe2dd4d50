"""The JSON Schema of stored models, for programs that read or check them without this library."""

from dataclasses import is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from dsbrdf.data.grid import CHANNELS
from dsbrdf.fitting.report import FitReport
from dsbrdf.model.lobes import FAMILIES
from dsbrdf.model.parameter_checks import INTERPOLATIONS
from dsbrdf.output.serialize import FORMAT, VERSION

__all__ = ["stored_model_schema"]

_SIMPLE = {str: "string", int: "integer", float: "number", bool: "boolean", NoneType: "null"}
_N_CHANNELS = len(CHANNELS)


def stored_model_schema() -> dict[str, Any]:
    """Return the schema (JSON Schema 2020-12) of what `dsbrdf.save` writes to a ``.json`` file."""
    of_channels = {"minItems": _N_CHANNELS, "maxItems": _N_CHANNELS}
    knots = _numbers(1) | {"minItems": 1}
    model = _object(
        {
            "theta_diff": knots | {"description": "Knots of amplitude and delta [rad]."},
            "amplitude": _numbers(3) | of_channels | {"description": "Channel, knot, lobe [1/sr]."},
            "kappa": _numbers(3) | {"description": "One for all channels or one for each; knot; lobe."},
            "gamma": _numbers(3) | {"description": "As kappa."},
            "center": _numbers(3) | {"description": "As kappa [rad]."},
            "elongation": _numbers(2) | {"description": "Knot, lobe."},
            "delta": _numbers(2) | of_channels | {"description": "Channel, knot [1/sr]."},
            "shape_theta_diff": knots | {"description": "Knots of kappa, gamma and center [rad]."},
            "elongation_theta_diff": knots | {"description": "Knots of elongation [rad]."},
            "interpolation": {"enum": list(INTERPOLATIONS)},
            "lobe": {"enum": list(FAMILIES)},
        }
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Directional Statistics BRDF model, as dsbrdf stores it",
        **_object(
            {
                "format": {"const": FORMAT},
                "version": {"const": VERSION},
                "model": model,
                "report": {"anyOf": [_schema(FitReport), {"type": "null"}]},
            }
        ),
    }


def _numbers(axes: int) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "number"}
    for _ in range(axes):
        schema = {"type": "array", "items": schema}
    return schema


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _schema(kind: Any) -> dict[str, Any]:
    """Schema of what an annotation says, as `dsbrdf.output.plain_content` reads it."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind in _SIMPLE:
        return {"type": _SIMPLE[kind]}
    if isinstance(kind, type) and is_dataclass(kind):
        return _object({name: _schema(hint) for name, hint in get_type_hints(kind).items()})
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin in (Union, UnionType):
        return {"anyOf": [_schema(choice) for choice in arguments]}
    if origin is dict:
        return {"type": "object", "additionalProperties": _schema(arguments[1])}
    if arguments[-1] is ...:
        return {"type": "array", "items": _schema(arguments[0])}
    items = [_schema(item) for item in arguments]
    return {"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}
