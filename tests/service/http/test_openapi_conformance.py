"""The service against its OpenAPI document: thousands of cases made of the document, each answer checked against it.

They are the same in every run; DSBRDF_SCHEMA_SEED=N makes others, and ``make soak`` more of them.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.guarded import new_key
from tests.support.server import Server
from tests.support.soak import SOAK, repeats

pytestmark = pytest.mark.slow

EXAMPLES = repeats(1, 200)
MIN_CASES = repeats(1000, 2000)
# As few seconds for the fits that the cases start as there can be; all of them find room in the queue.
SETTINGS = {"default_wait": "0.3", "max_wait": "0.3", "fit_seconds": "0.01", "queue_limit": "100000", "workers": "1"}

# What a document cannot say, so that a request may conform to it and yet be refused with 422: that two parameters
# exclude each other, are as long as each other, or are unit vectors; that knots increase; which formats hold a
# component; what a MERL file or a panorama holds, and (400) that a body is encoded as its header says. Of the
# components, a fit has those that have light (404).
CONFIG = """
hooks = "hooks.py"
headers = {{ Authorization = "{key}" }}
continue-on-failure = true
request-timeout = 60.0
cache.enabled = false
warnings = false

[generation]
max-examples = {examples}
database = "none"
no-shrink = true

[phases.stateful]
max-steps = 8

[checks.positive_data_acceptance]
expected-statuses = ["2xx", "304", "404", "409"]

[checks.negative_data_rejection]
expected-statuses = ["4xx"]


# DELETE cancels an unfinished fit, which stays.
[checks.use_after_free]
enabled = false

[dictionaries]
fits = {{ values = ["{fit}"] }}
measurements = {{ values = ["{measurement}"] }}

# Not those that delete: what they delete is missed by the others.
[[operations]]
include-operation-id = ["get_fit", "follow_fit", "get_components"]
parameters = {{ "path.fit_id" = {{ dictionary = "fits", probability = 0.8 }} }}

[[operations]]
include-operation-id = ["download_measurement"]
parameters = {{ "path.sha256" = {{ dictionary = "measurements", probability = 0.8 }} }}

[[operations]]
include-operation-id = ["delete_fit", "delete_measurement"]
phases.examples.extra-data-sources.responses = false
phases.coverage.extra-data-sources.responses = false
phases.fuzzing.extra-data-sources.responses = false

[[operations]]
include-operation-id = ["get_values", "get_component_values", "post_values", "post_component_values", "export_fit"]
parameters = {{ "path.fit_id" = "{fit}" }}

[[operations]]
include-operation-id = ["get_values", "get_component_values", "export_fit"]
checks.positive_data_acceptance.expected-statuses = ["2xx", "404", "422"]

[[operations]]
include-operation-id = [
  "submit_fit", "upload_measurement", "describe_table", "post_values", "post_component_values", "post_measured_values"
]
checks.positive_data_acceptance.expected-statuses = ["2xx", "400", "404", "422"]

# Their parameters and bodies are those of other operations, in the document and in the code, where every edge is tried.
[[operations]]
include-operation-id = [
  "get_component_values", "get_measured_values", "post_component_values", "post_measured_values", "draw_measurement",
  "draw_measurement_in_panorama", "upload_measurement", "describe_table"
]
phases.coverage.enabled = {every_edge}

[[operations]]
include-operation-id = ["draw_sphere_in_panorama", "draw_measurement_in_panorama"]
checks.positive_data_acceptance.expected-statuses = ["2xx", "404", "422"]
"""
# A .npy body is bytes, as that of any other file.
HOOKS = """
import schemathesis

schemathesis.serializer.alias("application/x-npy", "application/octet-stream")
"""


def test_service_conforms_to_its_openapi_document(
    own_server: Callable[..., Server], data: bytes, tmp_path: Path
) -> None:
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
    names = {"fit": fit["id"], "measurement": measurement, "key": header["Authorization"]}
    config.write_text(CONFIG.format(examples=EXAMPLES, every_edge=str(SOAK).lower(), **names))
    seed = os.environ.get("DSBRDF_SCHEMA_SEED", "1")
    (tmp_path / "hooks.py").write_text(HOOKS)
    command = [str(Path(sys.executable).parent / "schemathesis"), "--config-file", str(config), "run", "--no-color"]
    command += [f"--seed={seed}", "--report=json", f"--report-json-path={report}"]
    command.append(str(server.http.base_url.join("/openapi.json")))
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=3600)
    assert run.returncode == 0, run.stdout + run.stderr
    cases = json.loads(report.read_text())["test_cases"]["generated"]
    print(f"{cases} cases")
    assert cases >= MIN_CASES
    assert server.http.get("/health/live").status_code == 200
