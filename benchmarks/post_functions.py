"""Counts the functions of the project that one POST of a measurement calls in the web process.

``python -m benchmarks.post_functions`` prints the number, and with ``--list`` each function with its calls.
"""

import asyncio
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import httpx

from dsbrdf.data.merl import encode_merl
from dsbrdf_service.app import create_app
from dsbrdf_service.settings import Settings
from tests.support.materials import glossy_plastic

ROOT = Path(__file__).parents[1]
PACKAGES = (str(ROOT / "dsbrdf"), str(ROOT / "service"))


class Tracer:
    """Counts calls of the project's functions in all threads, comprehensions and lambdas included."""

    def __init__(self) -> None:
        self.is_on = False
        self.calls: Counter[tuple[str, int, str]] = Counter()

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Count a call; a function for `sys.setprofile`."""
        code = frame.f_code
        if self.is_on and event == "call" and code.co_filename.startswith(PACKAGES):
            self.calls[str(Path(code.co_filename).relative_to(ROOT)), code.co_firstlineno, code.co_name] += 1


async def trace_post(tracer: Tracer, content: bytes) -> None:
    """Send a measurement to a new service, and wait for its fit."""
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings(data_dir=Path(folder) / "data", workers=1))
        client = httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost", timeout=120)
        async with app.router.lifespan_context(app), client:
            tracer.is_on = True
            answer = await client.post("/v1/fits", content=content, headers={"Prefer": "wait=100"})
            tracer.is_on = False
    if answer.status_code != 201 or answer.json()["status"] != "succeeded":
        raise SystemExit(f"the fit did not succeed: {answer.text[:500]}")


def main(argv: Sequence[str]) -> int:
    """Print the number of functions."""
    tracer, content = Tracer(), encode_merl(glossy_plastic())
    threading.setprofile(tracer)
    sys.setprofile(tracer)
    asyncio.run(trace_post(tracer, content))
    sys.setprofile(None)
    in_service = sum(name.startswith("service") for name, _, _ in tracer.calls)
    print(f"{len(tracer.calls)} functions, {in_service} of them in the service, {tracer.calls.total()} calls")
    if "--list" in argv:
        for (name, line, function), number in sorted(tracer.calls.items()):
            print(f"{number:5} {name}:{line} {function}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
