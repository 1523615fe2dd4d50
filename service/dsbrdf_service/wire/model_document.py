"""The parameters of a model as a JSON document that says what they are: knots and control values, not values at angles.

A component's lobe has values at angles; this is for clients that evaluate the model themselves.
"""

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from dsbrdf.model.dsbrdf import DSBRDF

_Knots = Annotated[list[float], Field(description="Angles theta_diff, increasing; at least one.")]
_OverLobes = list[list[float]]
_OfChannels = list[list[list[float]]]


class AmplitudeCurves(BaseModel):
    """Heights of the lobes over theta_diff."""

    knots_deg: _Knots
    control_values: Annotated[_OfChannels, Field(description="[1/sr]; red, green, blue, then control values, lobes.")]


class ShapeValues(BaseModel):
    """Control values of the shapes: one list for all channels, or one for each; then control values, lobes."""

    kappa: Annotated[_OfChannels, Field(description="Scale.")]
    gamma: Annotated[_OfChannels, Field(description="Shape.")]
    center_deg: Annotated[_OfChannels, Field(description="Ring angle; 0 for a lobe about the half vector.")]


class ShapeCurves(BaseModel):
    """Shapes of the lobes over theta_diff."""

    knots_deg: _Knots
    control_values: ShapeValues


class ElongationCurves(BaseModel):
    """Stretches of the lobes over theta_diff."""

    knots_deg: _Knots
    control_values: Annotated[_OverLobes, Field(description="0 for a round lobe; control values, then lobes.")]


class DeltaCurves(BaseModel):
    """What the paper's model adds where theta_half < 1 degree; linear between the knots."""

    knots_deg: _Knots
    values_at_knots: Annotated[_OverLobes, Field(description="[1/sr]; red, green, blue, then knots.")]


class ModelDocument(BaseModel):
    """The model's own parameters, complete; `export?format=json` has them without loss.

    Control values are no values at angles: for those take the `components`' lobes, or `/brdf`.
    """

    lobe_family: Annotated[str, Field(description="Formula of the lobes: `hemi_epd` or `student`.")]
    interpolation: Annotated[
        str,
        Field(
            description="What control values are. `spline`: those of a clamped cubic B-spline in theta_diff, two more "
            "than knots (one, a constant, if there is one knot); for amplitude, kappa and gamma it is a spline of the "
            "logarithms. `linear`: values at the knots, between which log(1 + amplitude) and the others are linear. "
            "Before the first and after the last knot, the value there is kept."
        ),
    ]
    amplitude: AmplitudeCurves
    shape: ShapeCurves
    elongation: ElongationCurves
    delta: DeltaCurves


def model_document(model: DSBRDF) -> dict[str, Any]:
    """Return the content of a `ModelDocument`, in the shapes that `DSBRDF` has, with angles in degrees."""
    knots = _degrees(model.theta_diff)
    shape = {"kappa": model.kappa.tolist(), "gamma": model.gamma.tolist(), "center_deg": _degrees(model.center)}
    return {
        "lobe_family": model.lobe,
        "interpolation": model.interpolation,
        "amplitude": {"knots_deg": knots, "control_values": model.amplitude.tolist()},
        "shape": {"knots_deg": _degrees(model.shape_theta_diff), "control_values": shape},
        "elongation": {
            "knots_deg": _degrees(model.elongation_theta_diff),
            "control_values": model.elongation.tolist(),
        },
        "delta": {"knots_deg": knots, "values_at_knots": model.delta.tolist()},
    }


def _degrees(angles: NDArray[np.float64]) -> Any:
    """Return angles in degrees, rounded so that 5 degrees are written as 5."""
    return np.round(np.degrees(angles), 10).tolist()
