"""What a notebook shows of a public name: a signature that can be read, and a docstring."""

import inspect
from collections.abc import Callable, Iterator
from typing import Any

import dsbrdf


def public_callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Functions and classes of the package, and the methods of the classes that have signatures."""
    for name in dsbrdf.__all__:
        value = getattr(dsbrdf, name)
        if inspect.isclass(value) and not issubclass(value, BaseException):
            yield name, value
            methods = inspect.getmembers(value, callable)
            yield from ((f"{name}.{method}", found) for method, found in methods if not method.startswith("_"))
        elif inspect.isfunction(value):
            yield name, value


def test_signatures_name_types_as_the_source_does() -> None:
    expanded = [name for name, value in public_callables() if "numpy._typing" in str(inspect.signature(value))]
    assert expanded == []


def test_every_public_method_has_a_docstring() -> None:
    assert [name for name, value in public_callables() if not inspect.getdoc(value)] == []
