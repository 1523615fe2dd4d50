"""Rules on the source tree: which subpackage may import which, what is public, what must not be in a file."""

import ast
import importlib
import inspect
import re
import sys
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from importlib.metadata import entry_points
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

import pytest

import dsbrdf
from dsbrdf import errors
from dsbrdf.cli.arguments import SERVICE_COMMANDS

ROOT = Path(__file__).parents[2]
FOLDERS = {"dsbrdf": ROOT, "dsbrdf_service": ROOT / "service"}
"""The folders that the packages are in."""
LIBRARY = sorted((ROOT / "dsbrdf").rglob("*.py"))
SOURCES = sorted(path for folder in ("dsbrdf", "service", "benchmarks") for path in (ROOT / folder).rglob("*.py"))
COMMAND_LINE = ROOT / "dsbrdf/cli"
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())
LIGHT_COMMANDS = {"dsbrdf.cli.main", "dsbrdf.cli.arguments"}  # without the extra cli


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def imported_roots(nodes: list[ast.AST]) -> set[str]:
    modules = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    modules += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and node.level == 0]
    return {module.partition(".")[0] for module in modules}


def test_library_modules_import_only_allowed_packages() -> None:
    for path in LIBRARY:
        tree = tree_of(path)
        assert not {"dsbrdf_service"} & imported_roots(list(ast.walk(tree))), path
        assert not re.search(r"""import_module\(f?["']dsbrdf_service""", path.read_text()), path
        allowed = set(sys.stdlib_module_names) | {"dsbrdf", "numpy", "scipy", "threadpoolctl"}
        if path.parent == COMMAND_LINE and module_name(path) not in LIGHT_COMMANDS:
            allowed |= {"cyclopts", "rich"}
        assert imported_roots(list(tree.body)) <= allowed, path


def test_an_import_inside_a_function_is_of_an_extra_or_has_its_reason_beside_it() -> None:
    extras = {"distributed", "matplotlib", "mitsuba", "OpenEXR", "httpx", "python_calamine"}
    wrong = []
    for path in (path for path in SOURCES if "benchmarks" not in path.parts):
        lines = path.read_text().splitlines()
        functions = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.FunctionDef)]
        for node in (node for function in functions for node in ast.walk(function)):
            if isinstance(node, ast.Import | ast.ImportFrom) and not imported_roots([node]) & extras:
                near = lines[node.lineno - 3 : node.end_lineno]
                wrong += [] if any("#" in line for line in near) else [f"{name_of(path)}:{node.lineno}"]
    assert wrong == []


def test_what_the_package_offers_to_its_command_line_exists() -> None:
    offered = [*entry_points(group="dsbrdf.commands"), *entry_points(group="dsbrdf.engines")]
    assert sorted(point.name for point in offered) == sorted([*SERVICE_COMMANDS, "url"])
    assert all(callable(point.load()) for point in offered)


def test_test_files_are_short_and_share_only_the_support_package_with_the_benchmarks() -> None:
    tests, benchmarks = ((ROOT / folder).rglob("*.py") for folder in ("tests", "benchmarks"))
    wrong = [path for path in tests if re.search(r"^ *(from|import) benchmarks\b", path.read_text(), re.M)]
    wrong += [
        path for path in benchmarks if re.search(r"^ *(from|import) tests\b(?!\.support\b)", path.read_text(), re.M)
    ]
    assert [name_of(path) for path in wrong] == []
    assert [name_of(path) for path in (ROOT / "tests").rglob("*.py") if path.read_text().count("\n") > 350] == []


def test_all_lists_the_public_interface() -> None:
    values = {name: getattr(dsbrdf, name) for name in dir(dsbrdf) if not name.startswith("_")}
    ours = {name: value for name, value in values.items() if not inspect.ismodule(value)}
    mine = {name for name, value in ours.items() if getattr(value, "__module__", "").startswith("dsbrdf")}
    assert sorted(mine | {"ALGORITHM_VERSION", "__version__"}) == sorted(dsbrdf.__all__)
    assert {name for name, value in vars(errors).items() if inspect.isclass(value)} <= set(dsbrdf.__all__)


def test_signatures_of_public_names_can_be_read() -> None:
    """They are as the source names the types, and not what NumPy makes of them."""
    assert [name for name, value in public_callables() if "numpy._typing" in str(inspect.signature(value))] == []


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


package = pytest.mark.parametrize("package", FOLDERS)


def module_name(path: Path) -> str:
    """Dotted name of a source file, such as ``dsbrdf.data.geometry``; that of its package for an ``__init__.py``."""
    folder = FOLDERS["dsbrdf_service"] if FOLDERS["dsbrdf_service"] in path.parents else ROOT
    parts = path.relative_to(folder).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def modules_of(package: str) -> dict[str, Path]:
    return {module_name(path): path for path in sorted((FOLDERS[package] / package).rglob("*.py"))}


def imports_of(module: str, path: Path, modules: Collection[str]) -> set[str]:
    """Modules of the project that a file imports, at the top or inside a function.

    The service has relative imports of its modules only, the library none.
    """
    found, package = set(), module if path.stem == "__init__" else module.rpartition(".")[0]
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parent = resolve_name("." * node.level + (node.module or ""), package)
            assert parent.startswith("dsbrdf_service") is (node.level > 0), f"{path} imports {parent} by another name"
            names = {f"{parent}.{alias.name}" for alias in node.names}
            found |= names & set(modules)
            if names - set(modules):
                found.add(parent)
    return found & set(modules)


def wings_of(package: str) -> list[str]:
    docstring = " ".join((importlib.import_module(package).__doc__ or "").split())
    listed = re.search(r"Subpackages and modules, each importing only those to its left: ([\w, ]+)\.", docstring)
    assert listed, f"the docstring of {package} must list its subpackages"
    return listed[1].split(", ")


def wing_of(module: str) -> str:
    """Return the name of the subpackage, or of the module at the top of the package; empty for the package itself."""
    return module.partition(".")[2].partition(".")[0]


@package
def test_wings_are_those_that_exist_and_contributing_describes(package: str) -> None:
    existing = {wing_of(module) for module in modules_of(package)} - {""}
    table = (ROOT / "CONTRIBUTING.md").read_text().partition(f"| subpackage of `{package}` |")[2].partition("\n\n")[0]
    described = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", table, flags=re.MULTILINE)
    names = [name for cell in described for name in re.findall(r"`(\w+)`", cell)]
    assert sorted(names) == sorted(existing) == sorted(wings_of(package))


@package
def test_wing_imports_only_wings_to_its_left_and_no_two_modules_each_other(package: str) -> None:
    modules = modules_of(package)
    graph = {module: imports_of(module, path, modules) for module, path in modules.items()}
    # If the package's own file imports no module, it is to the left of all subpackages, otherwise to the right.
    top = len(modules) if graph[package] else -1
    order = {"": top} | {name: position for position, name in enumerate(wings_of(package))}
    pairs = [(module, imported) for module, found in graph.items() for imported in found]
    assert [pair for pair in pairs if order[wing_of(pair[1])] > order[wing_of(pair[0])]] == []
    TopologicalSorter(graph).prepare()  # raises an error that names the cycle


def test_the_tree_has_no_links() -> None:
    """In a clone on Windows and in an archive, a link is a text file."""
    folders = ("dsbrdf", "service", "tests", "benchmarks", "docs", "docker", "examples")
    paths = [*ROOT.iterdir(), *(path for folder in folders for path in (ROOT / folder).rglob("*"))]
    assert [name_of(path) for path in paths if path.is_symlink()] == []


def test_no_module_is_named_like_a_public_name() -> None:
    assert {f"dsbrdf.{name}" for name in dsbrdf.__all__} & set(modules_of("dsbrdf")) == set()


def pinned_by(lock: str) -> set[tuple[str, str]]:
    """Names and versions; a package may have a version for old Pythons, and another for new ones."""
    return set(re.findall(r"^([\w.-]+)==(\S+)", (ROOT / lock).read_text(), re.MULTILINE))


@pytest.mark.parametrize(
    ("lock", "extras", "groups"),
    [
        (".ci/installer.lock", [], []),
        ("service/requirements.lock", ["service", "client", "plot", "cli"], ["build"]),
        ("requirements.lock", PROJECT["project"]["optional-dependencies"], ["build", "dev"]),
        ("docs/requirements.lock", ["service", "client", "plot", "cli"], ["docs"]),
    ],
    ids=["installer", "service", "all", "docs"],
)
def test_lock_pins_with_hashes_and_names_no_registry(lock: str, extras: Iterable[str], groups: Iterable[str]) -> None:
    text = (ROOT / lock).read_text()
    hashed = re.findall(r"^\S+==.* \\\n +--hash=sha256:\w{64}", text, re.MULTILINE)
    assert len(hashed) == len(re.findall(r"^[^ #\n]", text, re.MULTILINE)) > 0
    assert "://" not in text
    assert "--index" not in text
    assert "--extra-index" not in text
    needs = [name for extra in extras for name in PROJECT["project"]["optional-dependencies"][extra]]
    needs += [name for group in groups for name in PROJECT["dependency-groups"][group]]
    wanted = {re.split(r"[><=\[]", need)[0].lower() for need in needs}
    assert wanted - {name for name, _ in pinned_by(lock)} == set()


@pytest.mark.parametrize("lock", ["service/requirements.lock", "docs/requirements.lock"])
def test_the_locks_pin_the_same_versions(lock: str) -> None:
    everything, part = pinned_by("requirements.lock"), pinned_by(lock)
    assert "numpy" in {name for name, _ in part}
    assert {name for name, _ in part - everything} & {name for name, _ in everything} == set()


def test_no_file_names_a_machine_path() -> None:
    suffixes = {".py", ".md", ".toml", ".lock", ".yml", ".yaml", ".sh", ".conf", ".html", ".js", ".css"}
    folders = ("dsbrdf", "service", "tests", "benchmarks", "docs", "examples", ".github")
    texts = [*ROOT.glob("[!.]*"), *ROOT.glob(".ci/*"), *ROOT.glob("docker/*")]
    texts += [path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in suffixes]
    assert len(texts) > 30
    place = re.compile(r"(?<![\w.])/(work|home|root|Users)/\w")
    assert [name_of(path) for path in texts if path.is_file() and place.search(path.read_text())] == []
