"""Writes the table of settings into the page on operations: ``python docs/_ext/settings_table.py``."""

from inspect import signature
from pathlib import Path

from annotated_types import Ge, Gt, Le

from dsbrdf_service.admin.serve import serve
from dsbrdf_service.settings import PREFIX, Settings

PAGE = Path(__file__).parents[1] / "operations.md"
_BEGIN = "<!-- settings:"
_END = "<!-- end of settings -->"
_SIGNS = {Ge: "from {0.ge}", Gt: "above {0.gt}", Le: "to {0.le}"}


def settings_table() -> str:
    """Return a Markdown table with a row for each setting."""
    rows = ["| variable | flag | default | |", "|---|---|---|---|"]
    for name, field in Settings.model_fields.items():
        flag = f"`--{name.replace('_', '-')}`" if name in signature(serve).parameters else ""
        default = "number of cores" if field.default_factory else f"`{str(field.default).lower()}`"
        bounds = " ".join(_SIGNS[type(bound)].format(bound) for bound in field.metadata if type(bound) in _SIGNS)
        rows.append(
            f"| `{PREFIX}{name.upper()}` | {flag} | {default} | {field.description}{bounds and f' ({bounds})'} |"
        )
    return "\n".join(rows)


def with_table(page: str) -> str:
    """Return a page with the present table between its two marks."""
    before, _, rest = page.partition(_BEGIN)
    mark, _, rest = rest.partition("\n")
    return f"{before}{_BEGIN}{mark}\n\n{settings_table()}\n\n{_END}{rest.partition(_END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text()))
