"""The framework's ceiling: FastAPI with constant values, under uvicorn as the service runs it.

One route has the address, the validated parameters and the document of the service's route; ``/values`` has no
parameters. Run as a program it serves on a free port of the loopback address, which its log says.
"""

from typing import Annotated

import uvicorn
from fastapi import FastAPI, Path, Query
from pydantic import Field

VALUES = [[0.1234567890123456, 0.02345678901234567, 0.003456789012345678]]
"""Values of one point, in the form of the service."""

Document = dict[str, list[list[float]]]
Angles = Annotated[list[Annotated[float, Field(ge=0, le=90)]], Query()]

app = FastAPI()


@app.get("/values")
async def values() -> Document:
    return {"values": VALUES}


@app.get("/v1/fits/{fit_id}/brdf")
async def brdf(
    fit_id: Annotated[str, Path(pattern="^[0-9a-f]{32}$")],
    theta_half_deg: Angles,
    theta_diff_deg: Angles,
    phi_diff_deg: Annotated[list[float], Query(default_factory=lambda: [90.0])],
) -> Document:
    del fit_id, theta_half_deg, theta_diff_deg, phi_diff_deg  # FastAPI has validated them.
    return {"values": VALUES}


if __name__ == "__main__":
    uvicorn.run(app, port=0, http="httptools", loop="asyncio", ws="none", access_log=False, server_header=False)
