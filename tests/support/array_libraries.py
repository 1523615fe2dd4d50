"""A program that evaluates exported Python files with PyTorch or JAX, and differentiates them.

``python array_libraries.py jax FOLDER`` writes for each NAME.py in the folder the values, and the derivatives of their
sum, weighted as pairs.npz says, in double precision.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

DIRECTIONS = ("omega_in", "omega_out")


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def with_torch(module: Any, pairs: dict[str, Any]) -> dict[str, Any]:
    torch: Any = importlib.import_module("torch")
    named = module.PARAMETERS | {name: pairs[name] for name in DIRECTIONS}
    tensors = {k: torch.tensor(v, dtype=torch.float64, requires_grad=True) for k, v in named.items()}
    values = module.evaluate(*(tensors[k] for k in DIRECTIONS), {k: tensors[k] for k in module.PARAMETERS})
    (values * torch.asarray(pairs["weight"])).sum().backward()
    slopes = {f"by {name}": tensor.grad.numpy() for name, tensor in tensors.items()}
    return slopes | {"values": values.detach().numpy()}


def with_jax(module: Any, pairs: dict[str, Any]) -> dict[str, Any]:
    jax: Any = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_disable_most_optimizations", True)  # Compiling takes longer than all the rest.

    def weighted(arrays: dict[str, Any]) -> Any:
        parameters = {name: arrays[name] for name in module.PARAMETERS}
        values = module.evaluate(*(arrays[name] for name in DIRECTIONS), parameters)
        return (values * pairs["weight"]).sum(), values

    named = module.PARAMETERS | {name: pairs[name] for name in DIRECTIONS}
    slopes, values = jax.jit(jax.grad(weighted, has_aux=True))({k: jax.numpy.asarray(v) for k, v in named.items()})
    return {f"by {name}": np.asarray(value) for name, value in slopes.items()} | {"values": np.asarray(values)}


if __name__ == "__main__":
    library, folder = sys.argv[1], Path(sys.argv[2])
    run = {"torch": with_torch, "jax": with_jax}[library]
    with np.load(folder / "pairs.npz") as stored:
        pairs = dict(stored)
    for path in folder.glob("*.py"):
        np.savez(path.with_suffix(".npz"), **run(loaded(path), pairs))
