"""Writes the references of the command line and of the HTTP service, as Markdown, from the code itself."""

import io
import json
import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import redirect_stdout
from typing import Any
from unittest import mock

from dsbrdf.cli.arguments import SERVICE_COMMANDS, entry_point
from dsbrdf.cli.commands import command_names
from dsbrdf.cli.main import main
from dsbrdf_service.app import create_app
from dsbrdf_service.http import problems
from dsbrdf_service.settings import Settings

_COLUMNS = "90"
_KEY_COMMANDS = ("add", "list", "revoke")
Document = dict[str, Any]
Answer = tuple[str, str, str]
"""Status, meaning, and types of the content."""


def command_line() -> str:
    """Return a section for each command with what its ``--help`` prints."""
    with mock.patch.dict(os.environ, {"COLUMNS": _COLUMNS}):
        helps = {name: _help_of(main, name) for name in command_names()}
        helps |= {name: _help_of(_service_main(name)) for name in SERVICE_COMMANDS}
        helps |= {f"keys {name}": _help_of(_service_main("keys"), name) for name in _KEY_COMMANDS}
    sections = [f"## dsbrdf {name}\n\n```text\n{text}\n```" for name, text in helps.items()]
    return "\n\n".join([*sections, ""])


def _service_main(command: str) -> Callable[[Sequence[str]], int]:
    found: Callable[[Sequence[str]], int] = entry_point("commands", command).load()
    return found


def _help_of(command: Callable[[Sequence[str]], int], *words: str) -> str:
    """Return what a command prints with ``--help``."""
    printed = io.StringIO()
    with redirect_stdout(printed):
        command([*words, "--help"])
    return "\n".join(line.rstrip() for line in printed.getvalue().rstrip().splitlines())


def openapi_document() -> Document:
    """Return the OpenAPI document of the service."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Duplicate Operation ID")  # GET and HEAD share one.
        return create_app(Settings()).openapi()


def http(document: Document) -> str:
    """Return a section for each group of operations of an OpenAPI document, and one for the kinds of problems."""
    groups: dict[str, list[str]] = {}
    everywhere = _common_answers(document)
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            text = "\n\n".join(_operation(f"{method.upper()} {path}", operation, everywhere))
            groups.setdefault(operation["tags"][0], []).append(text)
    sections = [f"## {name[0].upper()}{name[1:]}\n\n" + "\n\n".join(texts) for name, texts in groups.items()]
    common = "Besides its own answers, every operation under `/v1` can answer:\n\n" + _answers(sorted(everywhere))
    return "\n\n".join([common, *sections, _problems(), ""])


def _common_answers(document: Document) -> set[Answer]:
    """Return the answers that all operations under /v1 have."""
    return set.intersection(
        *(
            set(_answers_of(operation))
            for path, methods in document["paths"].items()
            if path.startswith("/v1/")
            for operation in methods.values()
        )
    )


def _answers_of(operation: Document) -> list[Answer]:
    return [
        (status, meaning, _media_types(answer.get("content", {})))
        for status, answer in sorted(operation["responses"].items())
        for meaning in answer["description"].split("; or: ")
    ]


def _answers(answers: Iterable[Answer]) -> str:
    return _table(("status", "meaning", "content"), list(answers))


def _operation(name: str, operation: Document, everywhere: Set[Answer]) -> Iterator[str]:
    yield f"### `{name}`"
    yield operation["description"]
    if parameters := operation.get("parameters"):
        rows = [(f"`{one['name']}`", one["in"], _type(one["schema"]), one.get("description", "")) for one in parameters]
        yield _table(("parameter", "in", "type", ""), rows)
    if body := operation.get("requestBody"):
        yield f"Body: {body.get('description', '')} {_media_types(body['content'])}"
    yield _answers(answer for answer in _answers_of(operation) if answer not in everywhere)
    for status, answer in sorted(operation["responses"].items()):
        example = answer.get("content", {}).get("application/json", {}).get("example")
        if status.startswith("2") and example is not None:
            yield f":::{{dropdown}} An answer {status}\n```json\n{_json(example)}\n```\n:::"
            return


def _problems() -> str:
    rows = [(f"`{kind}`", status, title) for kind, (status, title, _) in problems.KINDS.items()]
    intro = """## Problems

Errors are `application/problem+json` (RFC 9457). Their `type` is `urn:dsbrdf:problem:` and one of these kinds; their
`detail` is a sentence that says what is wrong.

"""
    return intro + _table(("kind", "status", ""), rows)


def _media_types(content: Document) -> str:
    return ", ".join(f"`{name}`" for name in content)


def _type(schema: Document) -> str:
    """Return the type of a parameter with its range or its choices."""
    if options := schema.get("anyOf"):
        return " or ".join(dict.fromkeys(_type(option) for option in options if option.get("type") != "null"))
    if choices := schema.get("enum"):
        return ", ".join(f"`{choice}`" for choice in choices)
    if schema.get("type") == "array":
        return f"{_type(schema.get('items', {}))}; may repeat"
    least, most = schema.get("minimum"), schema.get("maximum")
    bounds = (f"from {least:g}" if least is not None else "", f"to {most:g}" if most is not None else "")
    default = f"default `{json.dumps(schema['default'])}`" if schema.get("default") is not None else ""
    return ", ".join(filter(None, [" ".join(filter(None, [schema.get("type", ""), *bounds])), default]))


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(_cell(cell) for cell in line)} |" for line in lines)


def _cell(content: object) -> str:
    return " ".join(str(content).replace("|", "\\|").split())


def _json(example: object) -> str:
    """Return JSON with short lists on one line."""
    text = json.dumps(example, indent=2)
    while (shorter := _joined(text)) != text:
        text = shorter
    return text


def _joined(text: str) -> str:
    return re.sub(r"\[\s*([^\[\]{}]{0,60}?)\s*\]", lambda found: f"[{' '.join(found[1].split())}]", text)
