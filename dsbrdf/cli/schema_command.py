"""The command ``dsbrdf schema``: the JSON Schema of stored models."""

import json

from dsbrdf.output.json_schema import stored_model_schema


def schema() -> int:
    """Print the schema; return the exit code."""
    print(json.dumps(stored_model_schema(), indent=2))
    return 0
