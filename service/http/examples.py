"""Examples of the OpenAPI document; a test holds each against its schema."""

from typing import Any

import dsbrdf
from service.wire.fit_options import DEFAULTS

FIT_ID = "5f2c1d0a9b8e7f6a5c4d3e2f1a0b9c8d"
SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

MEASUREMENT: dict[str, Any] = {
    "sha256": SHA256,
    "size": 34_992_012,
    "valid_nodes": 1_005_210,
    "created": "2026-11-21T09:30:00.000000Z",
}
MEASUREMENT_LIST: dict[str, Any] = {"items": [MEASUREMENT]}

LOBES: dict[str, Any] = {
    "theta_diff_deg": [0.0, 90.0],
    "kappa": [[[0.11], [0.18]], [[0.05], [0.09]], [[0.03], [0.05]]],
    "gamma": [[[0.2], [0.4]], [[0.2], [0.4]], [[0.2], [0.4]]],
    "center_deg": [[[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]]],
    "delta": [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]],
    "interpolation": "linear",
}

FIT_SUMMARY: dict[str, Any] = {
    "id": FIT_ID,
    "status": "succeeded",
    "progress": 1.0,
    "measurement": SHA256,
    "options": DEFAULTS,
    "metrics": {"relative_rms": 0.081, "floor": 0.062, "excess": 1.31, "male": 0.0041},
    "error": None,
    "created": "2026-11-21T09:30:01.000000Z",
    "started": "2026-11-21T09:30:01.100000Z",
    "finished": "2026-11-21T09:30:02.500000Z",
    "algorithm": dsbrdf.ALGORITHM_VERSION,
    "library": dsbrdf.__version__,
}
FIT: dict[str, Any] = {**FIT_SUMMARY, "lobes": LOBES}
FIT_LIST: dict[str, Any] = {"items": [FIT_SUMMARY]}
_WITHOUT_RESULT: dict[str, Any] = {"metrics": None, "lobes": None, "finished": None}
RUNNING_FIT: dict[str, Any] = {**FIT, **_WITHOUT_RESULT, "status": "running", "progress": 0.42}
CANCELLED_FIT: dict[str, Any] = {
    **FIT,
    **_WITHOUT_RESULT,
    "status": "cancelled",
    "progress": 0.0,
    "finished": "2026-11-21T09:30:02.500000Z",
}

SUBMISSION: dict[str, Any] = {"measurement": SHA256, "options": {"n_lobes": 3, "horizon_cutoff_deg": 80}}
ANGLES: dict[str, Any] = {"theta_half_deg": [0, 10, 20], "theta_diff_deg": [0, 30, 30]}
DIRECTIONS: dict[str, Any] = {"omega_in": [[0.6, 0, 0.8]], "omega_out": [[-0.6, 0, 0.8]]}
VALUES: dict[str, Any] = {"values": [[0.42, 0.21, 0.11]]}

COMPONENT: dict[str, Any] = {
    "label": "diffuse",
    "lobes": [0],
    "parameters": LOBES,
    "albedo": [0.31, 0.13, 0.07],
    "half_width_deg": 62.5,
    "margin": 1.3,
}
_EMPTY = {
    "lobes": [],
    "parameters": {**LOBES, "kappa": [[[], []]] * 3, "gamma": [[[], []]] * 3, "center_deg": [[[], []]] * 3},
    "albedo": [0.0, 0.0, 0.0],
    "half_width_deg": None,
    "margin": None,
}
COMPONENTS: dict[str, Any] = {
    "items": [{"label": "specular_spike", **_EMPTY}, {"label": "specular_lobe", **_EMPTY}, COMPONENT]
}

STORED_MODEL: dict[str, Any] = {
    "format": "dsbrdf",
    "version": 1,
    "model": {
        "theta_diff": [0.0],
        "kappa": [[[0.11]], [[0.05]], [[0.03]]],
        "gamma": [[[0.2]], [[0.2]], [[0.2]]],
        "center": [[[0.0]], [[0.0]], [[0.0]]],
        "delta": [[0.0], [0.0], [0.0]],
        "interpolation": "linear",
    },
    "report": None,
}

EVENTS = (
    f'event: running\ndata: {{"id":"{FIT_ID}","status":"running","progress":0.42,"error":null}}\n\n'
    f'event: succeeded\ndata: {{"id":"{FIT_ID}","status":"succeeded","progress":1.0,"error":null}}\n\n'
)

_DETAILS = {
    "bad-request": "The client went away before the end of the body.",
    "bad-encoding": "The body is not valid gzip: it is cut off.",
    "unauthorized": "This service needs an API key; send it as 'Authorization: Bearer <key>'.",
    "storage-quota": "The measurements of this key would take more than its 10000 MB; delete some of them.",
    "not-found": f"There is no fit '{FIT_ID}'; GET /v1/fits lists those that there are.",
    "not-acceptable": "The values can be had as application/json or application/x-npy; accept one of them.",
    "request-timeout": "The body did not arrive in time; send it again.",
    "measurement-in-use": "1 unfinished fits use the measurement; cancel them or wait until they have ended.",
    "fit-not-finished": "The fit is running; its model exists when it has succeeded.",
    "too-large": "2000000 points are more than the 1000000 that one request may have.",
    "measurement-too-large": "The data is longer than 34992012 bytes; a MERL measurement has exactly 34992012 bytes.",
    "unsupported-media-type": "The content type 'text/plain' is not supported; send a MERL file as "
    "application/octet-stream.",
    "range-not-satisfiable": "The range begins beyond the end of the file, which has 34992012 bytes.",
    "measurement-format": "The data has only 17 bytes and seems cut off; "
    "a MERL measurement has exactly 34992012 bytes.",
    "invalid-argument": "n_lobes must be an integer from 1 to 8, not 9",
    "rate-limited": "The key has made more requests than it may in this time; wait as long as Retry-After says.",
    "queue-quota": "100 fits of this key are waiting already, as many as may; wait until some have ended.",
    "internal": "The service failed at this request; its log says why.",
    "queue-full": "1000 fits are waiting already, as many as may; the measurement is stored, ask again later.",
    "overloaded": "512 requests are in progress, as many as may; ask again later.",
    "shutting-down": "The service is shutting down and cannot finish this request; ask again later.",
    "not-ready": "The disk is not ready: 100 MB are free; the service wants 256 MB.",
    "disk-full": "The service has no disk space left for this request; try again when space has been freed.",
}


def problem(kind: str, status: int, title: str) -> dict[str, Any]:
    """Return an example of a problem document."""
    return {
        "type": f"urn:dsbrdf:problem:{kind}",
        "title": title,
        "status": status,
        "detail": _DETAILS[kind],
        "instance": "/v1/fits",
    }
