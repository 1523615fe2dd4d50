"""The command ``dsbrdf schema``: the JSON Schema of stored models."""

import argparse
import json

from dsbrdf.output.json_schema import stored_model_schema


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_print_schema)


def _print_schema(_: argparse.Namespace) -> int:
    print(json.dumps(stored_model_schema(), indent=2))
    return 0
