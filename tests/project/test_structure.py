"""Rules on the source tree: which wing may import which, what is public, what must not be in a file."""

import ast
import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Collection
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import dsbrdf
from dsbrdf.cli.arguments import SERVICE_COMMANDS

ROOT = Path(__file__).parents[2]
LIBRARY = sorted((ROOT / "dsbrdf").rglob("*.py"))
SOURCES = sorted(path for package in ("dsbrdf", "service", "benchmarks") for path in (ROOT / package).rglob("*.py"))
HEAVY = {"service", "dsbrdf_service", "fastapi", "starlette", "pydantic", "uvicorn", "matplotlib", "rich", "httpx"}
HEAVY |= {"distributed", "sklearn", "cyclopts"}
COMMAND_LINE = ROOT / "dsbrdf/cli"
LIGHT_COMMANDS = {"dsbrdf.cli.main", "dsbrdf.cli.arguments"}  # without the extra cli
PROMISED = {
    "DSBRDF",
    "FitOptions",
    "Measurement",
    "decompose",
    "fit",
    "load",
    "load_result",
    "parse_merl",
    "profiles",
    "read_merl",
    "render_sphere",
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
    modules = [name for name in modules if name in LIGHT_COMMANDS or not name.startswith("dsbrdf.cli.")]
    assert "dsbrdf.output.figures" in modules
    assert set(modules) > LIGHT_COMMANDS
    code = f"import json, sys, {', '.join(modules)}\nprint(json.dumps([*sys.modules]))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = {module.partition(".")[0] for module in json.loads(answer.stdout)}
    assert loaded & HEAVY == set()


def test_library_modules_import_only_allowed_packages() -> None:
    for path in LIBRARY:
        tree = ast.parse(path.read_text())
        assert not {"service", "dsbrdf_service"} & imported_roots(list(ast.walk(tree))), path
        assert not re.search(r"""import_module\(f?["']service""", path.read_text()), path
        allowed = set(sys.stdlib_module_names) | {"dsbrdf", "numpy", "scipy", "threadpoolctl"}
        if path.parent == COMMAND_LINE and module_name(path) not in LIGHT_COMMANDS:
            allowed |= {"cyclopts", "rich"}
        assert imported_roots(list(tree.body)) <= allowed, path


def test_what_the_package_offers_to_its_command_line_exists() -> None:
    offered = [*entry_points(group="dsbrdf.commands"), *entry_points(group="dsbrdf.engines")]
    assert sorted(point.name for point in offered) == sorted([*SERVICE_COMMANDS, "url"])
    assert all(callable(point.load()) for point in offered)


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
    values = {name: getattr(dsbrdf, name) for name in dir(dsbrdf) if not name.startswith("_")}
    mine = {
        name
        for name, value in values.items()
        if getattr(value, "__module__", "").startswith("dsbrdf") and not inspect.ismodule(value)
    }
    constants = {"ALGORITHM_VERSION", "__version__"}
    assert mine | constants == set(dsbrdf.__all__)
    assert set(dsbrdf.__all__) >= PROMISED
    assert len(dsbrdf.__all__) == len(set(dsbrdf.__all__))


def test_every_error_is_public() -> None:
    errors = importlib.import_module("dsbrdf.errors")
    assert {name for name, value in vars(errors).items() if inspect.isclass(value)} <= set(dsbrdf.__all__)


def test_modules_and_public_names_have_docstrings() -> None:
    trees = {path: ast.parse(path.read_text()) for path in SOURCES}
    assert [name_of(path) for path, tree in trees.items() if tree.body and not ast.get_docstring(tree)] == []
    values = {name: getattr(dsbrdf, name) for name in dsbrdf.__all__}
    assert [name for name, value in values.items() if callable(value) and not inspect.getdoc(value)] == []


PACKAGES = ("dsbrdf", "service")
# What `_repr_html_`, `plot` and `export` of the wings to their left call.
OF_METHODS = {"dsbrdf.output.notebook", "dsbrdf.output.export.export_file"}


def module_name(path: Path) -> str:
    """Dotted name of a source file, such as ``dsbrdf.data.grid``; that of its package for an ``__init__.py``."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def modules_of(package: str) -> dict[str, Path]:
    return {module_name(path): path for path in sorted((ROOT / package).rglob("*.py"))}


def imports_of(path: Path, modules: Collection[str]) -> set[str]:
    """Modules of the project that a file imports, at the top or inside a function."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parent = _imported_from(node, path)
            names = {f"{parent}.{alias.name}" for alias in node.names}
            found |= names & set(modules)
            if names - set(modules):
                found.add(parent)
    return found & set(modules) - OF_METHODS


def _imported_from(node: ast.ImportFrom, path: Path) -> str:
    """The full name of where a statement imports from; a package with two names has relative imports only."""
    relative = path.relative_to(ROOT).parts[0] == "service"
    if node.level == 0:
        assert not (relative and (node.module or "").startswith("service")), f"{path} imports service by its name"
        return node.module or ""
    assert relative, f"{path} has a relative import"
    package = path.relative_to(ROOT).parts[: -node.level]
    return ".".join([*package, *filter(None, [node.module])])


def wings_of(package: str) -> list[str]:
    """The wings in their order, as the package's docstring gives it."""
    docstring = " ".join((importlib.import_module(package).__doc__ or "").split())
    listed = re.search(r"Wings, each calling only those to its left: ([\w, ]+)\.", docstring)
    assert listed, f"the docstring of {package} must list its wings"
    return listed[1].split(", ")


def wing_of(module: str) -> str:
    """Name of the wing, or of the module at the top of the package; empty for the package itself."""
    return module.partition(".")[2].partition(".")[0]


@pytest.mark.parametrize("package", PACKAGES)
def test_wings_are_those_that_exist(package: str) -> None:
    existing = {wing_of(module) for module in modules_of(package)} - {""}
    assert sorted(existing) == sorted(wings_of(package))


@pytest.mark.parametrize("package", PACKAGES)
def test_wing_imports_only_wings_to_its_left(package: str) -> None:
    modules = modules_of(package)
    # A package whose own file imports nothing, only defines constants, is to the left of all wings; else to the right.
    top = len(modules) if imports_of(modules[package], modules) else -1
    order = {"": top} | {name: position for position, name in enumerate(wings_of(package))}
    wrong = [
        f"{module} imports {imported}"
        for module, path in modules.items()
        for imported in imports_of(path, modules)
        if order[wing_of(imported)] > order[wing_of(module)]
    ]
    assert wrong == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_import_cycle(package: str) -> None:
    modules = modules_of(package)
    graph = {module: imports_of(path, modules) for module, path in modules.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"modules import each other: {' <- '.join(error.args[1])}")


def offered_names(path: Path) -> set[str]:
    """Names that a package gives to those who import it."""
    names: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom | ast.Import):
            names |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
            if any(isinstance(target, ast.Name) and target.id == "__all__" for target in node.targets):
                names |= set(ast.literal_eval(node.value))
    return {name for name in names if not name.startswith("_")}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_is_named_like_a_public_name(package: str) -> None:
    packages = {module: path for module, path in modules_of(package).items() if path.name == "__init__.py"}
    offered = {f"{module}.{name}" for module, path in packages.items() for name in offered_names(path)}
    assert offered & set(modules_of(package)) == set()


@pytest.mark.parametrize("package", PACKAGES)
def test_contributing_describes_every_wing(package: str) -> None:
    table = (ROOT / "CONTRIBUTING.md").read_text().partition(f"| wing of `{package}` |")[2].partition("\n\n")[0]
    described = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", table, flags=re.MULTILINE)
    names = [name for cell in described for name in re.findall(r"`(\w+)`", cell)]
    assert sorted(names) == sorted(wings_of(package))


@pytest.mark.parametrize(
    ("lock", "of_docs"), [("requirements.lock", False), ("docs/requirements.lock", True)], ids=["all", "docs"]
)
def test_the_lock_pins_with_hashes_and_names_no_registry(lock: str, of_docs: bool) -> None:
    lines = (ROOT / lock).read_text().splitlines()
    requirements = [line for line in lines if line and not line.startswith((" ", "#"))]
    assert len(requirements) > 20
    assert [line for line in requirements if not re.match(r"^[A-Za-z0-9._-]+==\S+( ;.*)? \\$", line)] == []
    assert [line for line in lines if "://" in line or "--index" in line or "--extra-index" in line] == []
    pinned = {re.split(r"==", line)[0].lower() for line in requirements}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    needs = [name for extra, names in extras.items() for name in names if (extra == "docs") is of_docs]
    wanted = {re.split(r"[><=\[]", name)[0].lower() for name in needs} - {"dsbrdf"}
    assert wanted - pinned == set()


def test_both_locks_pin_the_same_versions() -> None:
    def pinned(lock: str) -> set[tuple[str, str]]:
        return set(re.findall(r"^([\w.-]+)==(\S+)", (ROOT / lock).read_text(), re.MULTILINE))

    everything, docs = pinned("requirements.lock"), pinned("docs/requirements.lock")
    names = dict(everything)
    shared = {(name, version) for name, version in docs if name in names}
    assert "numpy" in dict(shared)
    assert shared - everything == set()


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
