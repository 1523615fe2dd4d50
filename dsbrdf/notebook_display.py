"""Register the classes of the library with a notebook, so that it shows their objects as HTML."""

import sys
from importlib import import_module
from typing import Any

SHOWN_CLASSES = {
    "dsbrdf.components.component": ("Component",),
    "dsbrdf.components.layers": ("LayeredModel",),
    "dsbrdf.data.measurement": ("Measurement",),
    "dsbrdf.model.dsbrdf": ("DSBRDF",),
    "dsbrdf.result": ("FitReport", "FitResult"),
}
"""Names of the classes, by module; IPython needs only the names, so that no module is imported."""


def register() -> None:
    """Register the HTML of the classes with the running notebook, if there is one."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is None:
        return
    formatter = shell.display_formatter.formatters["text/html"]
    for module, names in SHOWN_CLASSES.items():
        for name in names:
            formatter.for_type_by_name(module, name, _html)


def _html(shown: Any) -> str:
    return str(import_module("dsbrdf.output.notebook").html(shown))
