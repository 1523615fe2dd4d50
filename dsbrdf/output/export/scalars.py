"""Run the exported formula on any scalars, such as symbols of a shader or numbers of a renderer.

The formula (`dsbrdf.output.export.formula`) computes with an array library `xp`. Here `xp` is NumPy with arrays of
objects: the objects compute by Python's operators, and by the functions that `array_library` is given.
"""

import operator
from collections.abc import Callable, Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "arctan", "expm1", "log1p")
"""Functions of one number that the formula calls."""


class ScalarArray(np.ndarray):
    """Array of scalars whose comparisons return what the scalars return, where NumPy's own would return booleans."""


for _name in ("lt", "ge", "gt", "eq", "and_", "or_"):
    _each = np.frompyfunc(getattr(operator, _name), 2, 1)
    setattr(ScalarArray, f"__{_name.strip('_')}__", lambda a, b, each=_each: each(a, b))


def direction(components: Iterable[Any]) -> Any:
    """Return an array (1, 3) of a direction's components."""
    array = np.empty((1, 3), dtype=object)
    for index, component in enumerate(components):  # NumPy would look into a scalar of drjit if it were in a list.
        array[0, index] = component
    return array.view(ScalarArray)


def array_library(is_scalar: Callable[[Any], bool], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """Return the array library in which the formula computes with scalars.

    The mapping has the functions in `FUNCTIONS`, and ``minimum``, ``maximum`` and ``where``. They are called only if an
    argument is a scalar; a function of plain numbers is computed at once.
    """

    def each(name: str, of_numbers: Callable[..., Any], count: int) -> Any:
        def call(*arguments: Any) -> Any:
            # Return a Python float: a NumPy number times one of our scalars would treat the scalar as an array.
            return functions[name](*arguments) if any(map(is_scalar, arguments)) else float(of_numbers(*arguments))

        return np.frompyfunc(call, count, 1)

    def clip(x: Any, low: Any, high: Any) -> Any:
        x = x if low is None else maximum(x, low)
        return x if high is None else minimum(x, high)

    def logaddexp(a: Any, b: Any) -> Any:
        high = maximum(a, b)
        return high + of_one["log1p"](of_one["exp"](minimum(a, b) - high))

    def where(condition: Any, first: Any, second: Any) -> Any:
        if not is_scalar(condition):
            return first if condition else second
        return first if first is second else functions["where"](condition, first, second)

    of_one = {name: each(name, getattr(np, name), 1) for name in FUNCTIONS}
    minimum, maximum = each("minimum", min, 2), each("maximum", max, 2)
    return SimpleNamespace(
        **of_one,
        clip=clip,
        minimum=minimum,
        maximum=maximum,
        logaddexp=logaddexp,
        where=np.frompyfunc(where, 3, 1),
        positive=lambda x: x,
        asarray=np.asarray,
        ones_like=lambda x: 1.0 + 0.0 * x,
        zeros_like=lambda x: 0.0 * x,
        finfo=lambda _: np.finfo(np.float32),
    )
