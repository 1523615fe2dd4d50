"""The framework's ceiling: FastAPI with one route that returns numbers, under uvicorn as the service runs it.

Run as a program it serves on a free port of the loopback address, which its log says.
"""

import uvicorn
from fastapi import FastAPI

VALUES = [[0.1234567890123456, 0.02345678901234567, 0.003456789012345678]]
"""Values of one point, in the form of the service."""

app = FastAPI()


@app.get("/values")
async def values() -> dict[str, list[list[float]]]:
    return {"values": VALUES}


if __name__ == "__main__":
    uvicorn.run(app, port=0, http="httptools", loop="asyncio", ws="none", access_log=False, server_header=False)
