"""The service's own description, and its health."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

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
from tests.support.server import Server


@pytest.fixture(scope="module")
def document(server: Server) -> dict[str, Any]:
    """The OpenAPI document as the service serves it."""
    content: dict[str, Any] = server.http.get("/openapi.json").json()
    return content


def operations(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def media(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Every body and answer, with its name and media type."""
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


def test_document_is_valid(document: dict[str, Any]) -> None:
    OpenAPIV31SpecValidator(document).validate()


def test_every_operation_has_a_description_and_examples(document: dict[str, Any]) -> None:
    for name, operation in operations(document):
        assert operation["summary"], name
        assert operation["description"], name
        assert operation["operationId"], name
    for name, media_type, entry in media(document):
        plain = media_type == "application/json" and "$ref" in entry.get("schema", {})
        if plain or media_type == "text/event-stream":
            assert "example" in entry, name


def test_every_example_is_valid(document: dict[str, Any]) -> None:
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
    described = {
        parameter["name"]: re.search(r"Default: `(.*)`\.$", parameter["description"])
        for parameter in document["paths"]["/v1/fits"]["post"]["parameters"]
        if parameter["in"] == "query" and parameter["name"] != "name"
    }
    defaults = to_wire(FitOptions()) | to_wire(TableOptions())
    assert set(described) == set(defaults)
    assert '"type": "null"' not in json.dumps(document["paths"]["/v1/fits"]["post"]["parameters"])  # a query has none
    given = {name: found[1] for name, found in described.items() if found}
    assert set(described) - set(given) == {name for name, value in defaults.items() if value == []}
    of_table = {name: given.pop(name) for name in TABLE_OPTIONS if name in given}
    assert from_query(given.items()) == FitOptions()
    assert table_from_query(of_table.items()) == TableOptions()
