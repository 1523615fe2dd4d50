"""The rules that keep the project in shape: who imports whom, what is public, what must not be in the tree."""

import ast
import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import dsbrdf

ROOT = Path(__file__).parents[2]
LIBRARY = sorted((ROOT / "dsbrdf").rglob("*.py"))
SOURCES = sorted(path for room in ("dsbrdf", "service", "benchmarks") for path in (ROOT / room).rglob("*.py"))
HEAVY = {"service", "fastapi", "starlette", "pydantic", "uvicorn", "matplotlib", "tqdm", "httpx", "distributed"}
PROMISED = {
    "DSBRDF",
    "FitOptions",
    "Measurement",
    "decompose",
    "fit",
    "load",
    "parse_merl",
    "profiles",
    "read_merl",
    "save",
    "write_merl",
}


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def imported_roots(nodes: list[ast.AST]) -> set[str]:
    modules = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    modules += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and node.level == 0]
    return {module.partition(".")[0] for module in modules}


def test_library_imports_load_only_numpy_and_scipy() -> None:
    modules = [module.name for module in pkgutil.walk_packages(dsbrdf.__path__, "dsbrdf.")]
    assert "dsbrdf.output.figures" in modules
    assert "dsbrdf.cli.main" in modules
    code = f"import json, sys, {', '.join(modules)}\nprint(json.dumps([*sys.modules]))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = {module.partition(".")[0] for module in json.loads(answer.stdout)}
    assert loaded & HEAVY == set()


@pytest.mark.parametrize("path", LIBRARY, ids=name_of)
def test_library_module_imports_only_allowed_packages(path: Path) -> None:
    tree = ast.parse(path.read_text())
    assert "service" not in imported_roots(list(ast.walk(tree)))
    allowed = set(sys.stdlib_module_names) | {"dsbrdf", "numpy", "scipy"}
    assert imported_roots(list(tree.body)) <= allowed


@pytest.mark.parametrize(
    ("folder", "forbidden"),
    [("tests", r"^ *(?:from|import) benchmarks\b"), ("benchmarks", r"^ *(?:from|import) tests\b(?!\.support\b)")],
    ids=["tests", "benchmarks"],
)
def test_tests_and_benchmarks_share_only_the_support_package(folder: str, forbidden: str) -> None:
    sources = (ROOT / folder).rglob("*.py")
    assert [name_of(path) for path in sources if re.search(forbidden, path.read_text(), re.MULTILINE)] == []


def test_test_files_have_at_most_350_lines() -> None:
    assert [name_of(path) for path in (ROOT / "tests").rglob("*.py") if path.read_text().count("\n") > 350] == []


def test_all_lists_the_public_interface() -> None:
    mine = {
        name
        for name, value in vars(dsbrdf).items()
        if not name.startswith("_")
        and getattr(value, "__module__", "").startswith("dsbrdf")
        and not inspect.ismodule(value)
    }
    constants = {name for name in dsbrdf.__all__ if name.isupper() and not callable(getattr(dsbrdf, name))}
    assert mine | constants == set(dsbrdf.__all__)
    assert set(dsbrdf.__all__) >= PROMISED
    assert len(dsbrdf.__all__) == len(set(dsbrdf.__all__))


def test_every_error_is_public() -> None:
    errors = importlib.import_module("dsbrdf.errors")
    assert {name for name, value in vars(errors).items() if inspect.isclass(value)} <= set(dsbrdf.__all__)


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_a_module_has_a_docstring(path: Path) -> None:
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree) or (not tree.body and path.name == "__init__.py")


@pytest.mark.parametrize("name", dsbrdf.__all__)
def test_a_public_name_has_a_docstring(name: str) -> None:
    value = getattr(dsbrdf, name)
    assert not callable(value) or inspect.getdoc(value)


@pytest.mark.parametrize("package", ["dsbrdf", "service"])
def test_every_room_is_described(package: str) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text().partition(f"| room of `{package}`")[2].partition("\n\n")[0]
    rooms = {path.name for path in (ROOT / package).glob("*.py")} - {"__init__.py"}
    assert set(re.findall(r"`(\w+\.py)`", text)) == rooms


def test_the_lock_pins_with_hashes_and_names_no_registry() -> None:
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    requirements = [line for line in lines if line and not line.startswith((" ", "#"))]
    assert len(requirements) > 20
    assert [line for line in requirements if not re.match(r"^[A-Za-z0-9._-]+==\S+( ;.*)? \\$", line)] == []
    assert [line for line in lines if "://" in line or "--index" in line or "--extra-index" in line] == []
    pinned = {re.split(r"==", line)[0].lower() for line in requirements}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = {re.split(r"[><=\[]", name)[0].lower() for names in extras.values() for name in names} - {"dsbrdf"}
    assert wanted - pinned == set()


def test_no_file_names_a_machine_path() -> None:
    suffixes = {".py", ".md", ".toml", ".lock", ".yml", ".yaml", ".sh", ".conf", ".html", ".js", ".css"}
    hidden = {".git", ".venv", ".mypy_cache", ".ruff_cache", ".pytest_cache", ".hypothesis", "out", "build", "dist"}
    texts = [ROOT / "Makefile", *ROOT.glob(".ci/*"), *ROOT.glob("docker/*")]
    texts += [
        path for path in ROOT.rglob("*") if path.suffix in suffixes and not hidden & set(path.relative_to(ROOT).parts)
    ]
    assert len(texts) > 30
    place = re.compile(r"(?<![\w.])/(work|home|root|Users)/\w")
    assert [name_of(path) for path in texts if path.is_file() and place.search(path.read_text())] == []
