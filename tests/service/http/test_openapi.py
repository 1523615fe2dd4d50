"""The OpenAPI document, a client generated from it, and the service against it: thousands of cases made of it.

The cases are the same in every run; DSBRDF_SCHEMA_SEED=N makes others, and ``make soak`` more of them.
"""

import importlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import pytest
from openapi_schema_validator import validate
from openapi_spec_validator import OpenAPIV31SpecValidator

import dsbrdf_service
from dsbrdf import FitOptions, TableOptions
from dsbrdf.samples.table_options import TABLE_OPTIONS
from dsbrdf_service.app import create_app
from dsbrdf_service.http.problems import KINDS
from dsbrdf_service.settings import Settings
from dsbrdf_service.wire import from_query, table_from_query, to_wire
from tests.support.server import QUICK, Server, StartServer, new_key
from tests.support.soak import SOAK, repeats


@pytest.fixture(scope="module")
def document(server: Server) -> dict[str, Any]:
    content: dict[str, Any] = server.http.get("/openapi.json").json()
    return content


def operations(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def media(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for name, operation in operations(document):
        parts = {"body": operation.get("requestBody", {}), **operation["responses"]}
        for part, content in parts.items():
            for media_type, entry in content.get("content", {}).items():
                yield f"{name} {part}", media_type, entry


def test_document_describes_every_route_of_the_interface_without_a_warning(tmp_path: Path) -> None:
    app = create_app(Settings(data_dir=tmp_path / "data"))
    served = {path for route in app.routes if (path := getattr(route, "path", "")).startswith(("/v1/", "/health/"))}
    assert len(served) > 10
    assert served <= set(app.openapi()["paths"])


def test_every_operation_has_a_description_and_examples(document: dict[str, Any]) -> None:
    for name, operation in operations(document):
        assert operation["summary"], name
        assert operation["description"], name
        assert operation["operationId"], name
        assert ("401" in operation["responses"]) is ("/health/" not in name), name
        if name.startswith("POST") and name.endswith("/brdf"):  # Points and values are JSON or arrays.
            assert operation["requestBody"]["content"].keys() == operation["responses"]["200"]["content"].keys()
    for name, media_type, entry in media(document):
        plain = media_type == "application/json" and "$ref" in entry.get("schema", {})
        if plain or media_type == "text/event-stream":
            assert "example" in entry, name


def test_document_and_its_examples_are_valid(document: dict[str, Any]) -> None:
    OpenAPIV31SpecValidator(document).validate()
    count = 0
    for _, _, entry in media(document):
        schema = {**entry.get("schema", {"type": "string"}), "components": document["components"]}
        shown = [entry["example"]] if "example" in entry else []
        for example in [*shown, *(example["value"] for example in entry.get("examples", {}).values())]:
            validate(example, schema)
            count += 1
    assert count > 15


def test_every_kind_of_problem_that_is_raised_is_in_the_table() -> None:
    text = "".join(path.read_text() for path in Path(dsbrdf_service.__file__).parent.rglob("*.py"))
    raised = set(re.findall(r"""\b(?:ProblemError|super\(\).__init__|_response)\(\s*["']([a-z-]+)["']""", text))
    assert len(raised) > 20
    assert raised <= set(KINDS)


def test_options_are_described_with_their_defaults(document: dict[str, Any]) -> None:
    parameters = document["paths"]["/v1/fits"]["post"]["parameters"]
    options = [one for one in parameters if one["in"] == "query" and one["name"] != "name"]
    described = {one["name"]: re.search(r"Default: `(.*)`\.$", one["description"]) for one in options}
    defaults = to_wire(FitOptions()) | to_wire(TableOptions())
    assert set(described) == set(defaults)
    assert '"type": "null"' not in json.dumps(parameters)  # a query has none
    given = {name: found[1] for name, found in described.items() if found}
    assert set(described) - set(given) == {name for name, value in defaults.items() if value == []}
    of_table = {name: given.pop(name) for name in TABLE_OPTIONS if name in given}
    assert from_query(given.items()) == FitOptions()
    assert table_from_query(of_table.items()) == TableOptions()


CONFIG = Path(__file__).with_name("schemathesis.toml")
# As few seconds for the fits that the cases start as there can be; all of them find room in the queue.
SETTINGS = {
    "default_wait_seconds": "0.3",
    "max_wait_seconds": "0.3",
    "fit_seconds": "0.01",
    "queue_limit": "100000",
    "workers": "1",
}
# A .npy body is bytes, as that of any other file.
HOOKS = """
import gc

import schemathesis

gc.disable()  # A run is short, and looks for its garbage for a tenth of the time.
schemathesis.serializer.alias("application/x-npy", "application/octet-stream")
"""


@pytest.mark.slow
def test_service_conforms_to_its_openapi_document(own_server: StartServer, data: bytes, tmp_path: Path) -> None:
    server = own_server(require_keys="true", key_requests_per_second="100000")
    header = new_key(server, "x")[1]
    server.http.headers.update(header)
    measurement = server.http.post("/v1/measurements", content=data).json()["sha256"]
    fit = server.submit(measurement, n_lobes=2, em_iterations=10).json()
    assert fit["status"] == "succeeded"
    server.stop(signal.SIGTERM)
    server.environment.update({f"DSBRDF_{name.upper()}": value for name, value in SETTINGS.items()})
    server.start()

    config, report = tmp_path / "schemathesis.toml", tmp_path / "report.json"
    text = Template(CONFIG.read_text()).substitute(fit=fit["id"], measurement=measurement, key=header["Authorization"])
    if SOAK:
        text = text.replace("max-examples = 1", "max-examples = 200")
        text = re.sub(r"(phases\.\w+\.enabled) = false", r"\1 = true", text)
    config.write_text(text)
    seed = os.environ.get("DSBRDF_SCHEMA_SEED", "1")
    (tmp_path / "hooks.py").write_text(HOOKS)
    command = [str(Path(sys.executable).parent / "schemathesis"), "--config-file", str(config), "run", "--no-color"]
    command += [f"--seed={seed}", "--report=json", f"--report-json-path={report}"]
    command.append(str(server.http.base_url.join("/openapi.json")))
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=3600)
    assert run.returncode == 0, run.stdout + run.stderr
    cases = json.loads(report.read_text())["test_cases"]["generated"]
    print(f"{cases} cases")
    assert cases >= repeats(1000, 2000)
    assert server.http.get("/health/live").status_code == 200


@pytest.fixture(scope="module")
def call(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Any]]:
    """Call an operation of the generated client by its module's name, and return the whole answer."""
    folder = tmp_path_factory.mktemp("generated")
    page = (Path(__file__).parents[3] / "docs/http.md").read_text()
    found = re.search(r"```yaml\n(# generator.yaml\n.*?)```", page, re.DOTALL)
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


@pytest.mark.slow
def test_generated_client_sends_and_reads_what_is_described(call: Callable[..., Any], plastic_file: Path) -> None:
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
    labels = [part.label for part in call("components.get_components", fit.id).parsed.items]
    parts = [call("values.get_component_values", fit.id, label, **angles).parsed.values for label in labels]
    np.testing.assert_allclose(np.sum(parts, axis=0), values, rtol=1e-9)
    layers = model("ExportFitComponentType0").LAYERS
    exported = call("export.export_fit", fit.id, format_=model("ExportFitFormat").JSON, component=layers)
    assert exported.parsed.payload.read() == exported.content
    picture = call("figures.draw_sphere", fit.id, model("DrawSphereFileFormat").NPY, size=16).parsed.payload
    assert np.load(picture).shape == (16, 16, 3)

    missing = call("fits.get_fit", "0" * 32)
    assert (missing.status_code, missing.parsed.status) == (404, 404)
    assert call("fits.delete_fit", fit.id).parsed.status == "deleted"
