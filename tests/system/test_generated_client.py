"""A client that is generated from the OpenAPI document, used against the service."""

import importlib
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.server import QUICK, Server

DOCS = Path(__file__).parents[2] / "docs" / "http.md"


@pytest.fixture(scope="module")
def call(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Any]]:
    """Call an operation of the generated client by its module's name, and return the whole answer."""
    folder = tmp_path_factory.mktemp("generated")
    found = re.search(r"```yaml\n(# generator.yaml\n.*?)```", DOCS.read_text(), re.DOTALL)
    assert found
    (folder / "generator.yaml").write_text(f"{found[1]}post_hooks: []\n")
    (folder / "openapi.json").write_bytes(server.http.get("/openapi.json").content)
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--path", "openapi.json"]
    command += ["--config", "generator.yaml", "--meta", "none", "--output-path", "dsbrdf_api"]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    left_out = {line.strip() for line in done.stdout.splitlines() if line.strip().startswith("Unsupported")}
    assert left_out <= {f"Unsupported content type text/{kind}" for kind in ("csv", "plain", "tab-separated-values")}
    assert "will not be generated" not in done.stdout
    sys.path.insert(0, str(folder))
    client = importlib.import_module("dsbrdf_api").Client(base_url=str(server.http.base_url), timeout=60.0)

    def detailed(operation: str, *arguments: Any, **named: Any) -> Any:
        module = importlib.import_module(f"dsbrdf_api.api.{operation}")
        return module.sync_detailed(*arguments, client=client, **named)

    try:
        with client:
            yield detailed
    finally:
        sys.path.remove(str(folder))


def model(name: str) -> Any:
    return getattr(importlib.import_module("dsbrdf_api.models"), name)


def file(path: Path) -> Any:
    return importlib.import_module("dsbrdf_api.types").File(payload=BytesIO(path.read_bytes()))


def test_generated_client_sends_and_reads_what_the_document_describes(
    call: Callable[..., Any], plastic_file: Path
) -> None:
    stored = call("measurements.upload_measurement", body=file(plastic_file)).parsed
    assert call("measurements.download_measurement", stored.sha256).content == plastic_file.read_bytes()
    request = model("FitRequest").from_dict({"measurement": stored.sha256, "options": QUICK})
    fit = call("fits.submit_fit", body=request, name="generated").parsed
    assert (fit.status, fit.measurement, fit.options.n_lobes) == ("succeeded", stored.sha256, 1)
    numbers = {name: QUICK[name] for name in ("n_lobes", "em_iterations")}
    again = call("fits.submit_fit", body=file(plastic_file), method=model("SubmitFitMethod").PAPER, **numbers)
    assert (again.status_code, again.parsed.id) == (200, fit.id)
    assert fit.id in {item.id for item in call("fits.list_fits").parsed.items}
    assert b"event: succeeded" in call("fits.follow_fit", fit.id).content
    assert call("fits.rename_fit", fit.id, body=model("NewName")(name="another name")).parsed.name == "another name"

    angles: dict[str, Any] = {"theta_half_deg": [5.0, 20.0], "theta_diff_deg": [10.0]}
    values = call("values.get_values", fit.id, **angles).parsed.values
    assert call("values.post_values", fit.id, body=model("AnglesRequest")(**angles)).parsed.values == values
    parts = [
        call("values.get_component_values", fit.id, part.label, **angles).parsed.values
        for part in call("components.get_components", fit.id).parsed.items
    ]
    np.testing.assert_allclose(np.sum(parts, axis=0), values, rtol=1e-9)
    layers = model("ExportFitComponentType0").LAYERS
    exported = call("export.export_fit", fit.id, format_=model("ExportFitFormat").JSON, component=layers)
    assert exported.parsed.payload.read() == exported.content
    picture = call("figures.draw_sphere", fit.id, model("DrawSphereFileFormat").NPY, size=16).parsed.payload
    assert np.load(picture).shape == (16, 16, 3)

    missing = call("fits.get_fit", "0" * 32)
    assert (missing.status_code, missing.parsed.status) == (404, 404)
    assert call("fits.delete_fit", fit.id).parsed.status == "deleted"
