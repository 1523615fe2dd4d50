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
    """A class of the generated client."""
    return getattr(importlib.import_module("dsbrdf_api.models"), name)


def file(path: Path) -> Any:
    """A body of a generated call."""
    return importlib.import_module("dsbrdf_api.types").File(payload=BytesIO(path.read_bytes()))


@pytest.fixture(scope="module")
def fit(call: Callable[..., Any], plastic_file: Path) -> Any:
    """A fit that the generated client has made of a file."""
    numbers = {name: QUICK[name] for name in ("n_lobes", "em_iterations")}
    method = model("SubmitFitMethod").PAPER
    answer = call("fits.submit_fit", body=file(plastic_file), name="generated", method=method, **numbers)
    assert answer.status_code in (200, 201), answer.content[:300]
    assert answer.parsed.status == "succeeded"
    assert answer.parsed.options.n_lobes == 1
    return answer.parsed


def test_measurement_is_sent_and_found(call: Callable[..., Any], plastic_file: Path) -> None:
    stored = call("measurements.upload_measurement", body=file(plastic_file)).parsed
    assert stored.size == plastic_file.stat().st_size
    assert stored.sha256 in {item.sha256 for item in call("measurements.list_measurements").parsed.items}
    same = call("measurements.download_measurement", stored.sha256).content
    assert same == plastic_file.read_bytes()
    request = model("FitRequest").from_dict({"measurement": stored.sha256, "options": QUICK})
    assert call("fits.submit_fit", body=request).parsed.measurement == stored.sha256


def test_fit_is_listed_followed_and_renamed(call: Callable[..., Any], fit: Any) -> None:
    listed = {item.id: item for item in call("fits.list_fits").parsed.items}
    assert listed[fit.id].options.n_lobes == 1
    assert call("fits.get_fit", fit.id, wait=1.0).parsed.model is not None
    assert b"event: succeeded" in call("fits.follow_fit", fit.id).content
    renamed = call("fits.rename_fit", fit.id, body=model("NewName")(name="another name"))
    assert renamed.parsed.name == "another name"


def test_values_and_components(call: Callable[..., Any], fit: Any) -> None:
    one = call("values.get_values", fit.id, theta_half_deg=[5.0, 20.0], theta_diff_deg=[10.0]).parsed.values
    body = model("AnglesRequest")(theta_half_deg=[5.0, 20.0], theta_diff_deg=[10.0])
    assert call("values.post_values", fit.id, body=body).parsed.values == one
    components = call("components.get_components", fit.id).parsed.items
    parts = [
        call("values.get_component_values", fit.id, part.label, theta_half_deg=[5.0, 20.0], theta_diff_deg=[10.0])
        for part in components
    ]
    np.testing.assert_allclose(np.sum([part.parsed.values for part in parts], axis=0), one, rtol=1e-9)


def test_files_and_pictures_are_bytes(call: Callable[..., Any], fit: Any) -> None:
    # The layers are exported faster than the whole fit; a table of the components has all of them.
    layers = {"component": model("ExportFitComponentType0").LAYERS}
    for name, part in (("json", layers), ("components", {})):
        exported = call("export.export_fit", fit.id, format_=model("ExportFitFormat")(name), **part)
        assert exported.status_code == 200, exported.content
        assert exported.parsed.payload.read() == exported.content
        assert len(exported.content) > 200
    picture = call("figures.draw_sphere", fit.id, model("DrawSphereFileFormat").PNG, size=16).parsed.payload.read()
    assert picture.startswith(b"\x89PNG")
    array = np.load(call("figures.draw_sphere", fit.id, model("DrawSphereFileFormat").NPY, size=16).parsed.payload)
    assert array.shape == (16, 16, 3)


def test_refusals_are_problems_and_a_fit_is_deleted(call: Callable[..., Any], fit: Any) -> None:
    missing = call("fits.get_fit", "0" * 32)
    assert missing.status_code == 404
    assert missing.parsed.title
    above = call("values.get_values", fit.id, theta_half_deg=[95.0], theta_diff_deg=[0.0])
    assert above.status_code == 422
    assert "theta_half_deg" in above.parsed.detail
    assert call("fits.delete_fit", fit.id).parsed.status == "deleted"
    assert call("fits.get_fit", fit.id).status_code == 404
