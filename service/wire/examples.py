"""Example documents for the OpenAPI document, by the model of each; a test checks them."""

from typing import Any

import numpy as np

import dsbrdf
from dsbrdf import DSBRDF

from .fit_options import DEFAULTS
from .model_document import model_document

FIT_ID = "5f2c1d0a9b8e7f6a5c4d3e2f1a0b9c8d"
SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
_CREATED, _STARTED, _FINISHED = (f"2026-11-21T09:30:{second}Z" for second in ("01.000000", "01.100000", "02.500000"))

_MEASUREMENT: dict[str, Any] = {
    "sha256": SHA256,
    "name": "nickel",
    "size": 34_992_012,
    "valid_nodes": 1_005_210,
    "created": _CREATED,
}

_MODEL = DSBRDF(np.zeros(1), np.array([[[0.11]], [[0.05]], [[0.03]]]), np.ones((1, 1, 1)), np.full((1, 1, 1), 0.2))
_COMPONENTS: dict[str, Any] = {
    "items": [
        {
            "label": "specular_lobe",
            "lobe": {
                "theta_diff_deg": [0, 30, 60, 75],
                "height": [[1.2, 1.2, 1.21], [1.25, 1.25, 1.26], [2.9, 2.9, 2.91], [9.6, 9.6, 9.61]],
                "half_width_deg": [5.7, 5.7, 5.6, 5.4],
                "tail": [2.1, 2.1, 2.0, 1.9],
                "elongation": [0.5, 0.6, 0.7, 0.8],
            },
            "albedo": [0.041, 0.041, 0.041],
            "color": [1.0, 1.0, 1.0],
            "half_width_deg": 5.7,
            "clarity": 0.82,
        },
        {
            "label": "diffuse",
            "lobe": {
                "theta_diff_deg": [0, 30, 60, 75],
                "height": [[0.11, 0.05, 0.03], [0.11, 0.05, 0.03], [0.1, 0.04, 0.03], [0.08, 0.03, 0.02]],
                "half_width_deg": [74.0, 74.0, 73.0, 72.0],
                "tail": [1.1, 1.1, 1.1, 1.1],
                "elongation": [0.0, 0.0, 0.0, 0.0],
            },
            "albedo": [0.33, 0.15, 0.09],
            "color": [1.0, 0.455, 0.273],
            "half_width_deg": 74.0,
            "clarity": 0.93,
        },
    ]
}

_SUMMARY: dict[str, Any] = {
    "id": FIT_ID,
    "name": "nickel",
    "status": "succeeded",
    "progress": 1.0,
    "measurement": SHA256,
    "options": DEFAULTS,
    "metrics": {
        "relative_rms": 0.031,
        "floor": 0.062,
        "symmetric_floor": 0.012,
        "excess": 0.5,
        "male": 0.0041,
        "albedo_error": 0.006,
        "psnr": 41.2,
        "ssim": 0.993,
    },
    "error": None,
    "created": _CREATED,
    "started": _STARTED,
    "finished": _FINISHED,
    "algorithm": dsbrdf.ALGORITHM_VERSION,
    "library": dsbrdf.__version__,
}
DIRECTIONS: dict[str, Any] = {"omega_in": [[0.6, 0, 0.8]], "omega_out": [[-0.6, 0, 0.8]]}
ANGLES: dict[str, Any] = {"theta_half_deg": [0, 10], "theta_diff_deg": [0, 30], "phi_diff_deg": [90, 45]}
BY_MODEL: dict[str, dict[str, Any]] = {
    "MeasurementDocument": _MEASUREMENT,
    "MeasurementDetails": {**_MEASUREMENT, "fits": [FIT_ID]},
    "MeasurementList": {"items": [_MEASUREMENT]},
    "FitRequest": {"measurement": SHA256, "options": {"n_lobes": 3, "horizon_cutoff_deg": 80}},
    "FitDocument": {
        **_SUMMARY,
        "warnings": [],
        "components": _COMPONENTS["items"],
        "model": model_document(_MODEL),
    },
    "FitList": {"items": [_SUMMARY]},
    "RemovedFit": {"id": FIT_ID, "status": "cancelled"},
    "ComponentList": _COMPONENTS,
    "Values": {"values": [[0.42, 0.21, 0.11]]},
    "Health": {"status": "live", "version": dsbrdf.__version__},
    "Readiness": {"status": "ready", "version": dsbrdf.__version__, "lost_files": 0},
}
EVENTS = (
    f'event: running\ndata: {{"id":"{FIT_ID}","status":"running","progress":0.42,"error":null}}\n\n'
    f'event: succeeded\ndata: {{"id":"{FIT_ID}","status":"succeeded","progress":1.0,"error":null}}\n\n'
)
