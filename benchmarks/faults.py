"""Plants one-line faults, runs the tests that cover the line, and prints each fault that no test has noticed.

A fault changes one operator, bound, constant or branch, or leaves out one statement; they are drawn at random, equally
often from each wing and of each kind. Calls of the logger are left alone. Which tests cover a line and how long they
take is found once and kept in out/faults; remove the folder after larger changes. The wing's own tests run in a copy of
the committed and changed files, the quickest first, until one fails.
"""

import argparse
import ast
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, NoReturn

import coverage
import pytest

ROOT = Path(__file__).parents[1]
KEPT = Path("out/faults")
SERVICE = "service/dsbrdf_service"
WINGS = (
    *(f"dsbrdf/{wing}" for wing in ("model", "fitting", "components", "samples")),
    *(f"{SERVICE}/{wing}" for wing in ("storage", "queue.py", "access.py")),
)
PRELOADED = (
    "fastapi",
    "httpx",
    "hypothesis",
    "matplotlib.figure",
    "scipy.interpolate",
    "scipy.ndimage",
    "scipy.optimize",
)
"""Packages that take most of the time of a run's start; forks have imported them."""
OWN_PACKAGES = ("benchmarks", "dsbrdf", "dsbrdf_service", "tests")
"""Packages that a run with a fault imports anew, from the copy."""
REPRODUCED = "tests/library/test_reproduced.py"
FURTHER_TESTS = {
    "access": ["tests/service/test_client.py", "tests/service/http/test_limits.py"],
    "compute": ["tests/service/test_queue.py", "tests/service/api/test_pictures.py"],
    "queue": ["tests/service/api/test_fits.py", "tests/service/http/test_limits.py"],
    "fitting": ["tests/library/test_result.py", REPRODUCED],
    **{wing: [REPRODUCED] for wing in ("components", "samples")},
    "storage": [
        "tests/service/api/test_results.py",
        "tests/service/api/test_measurements.py",
        "tests/service/admin/test_commands.py",
    ],
    "model": ["tests/library/output/test_comparison.py", REPRODUCED],
}
MAX_TEST_SECONDS = 200.0  # A fault that survives the quickest tests of this time counts as not noticed.
MAX_RUN_SECONDS = 200.0  # A fault may cause an endless loop, which counts as noticed.
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
BOUNDS = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">"}
OPPOSITES = {ast.Eq: "!=", ast.NotEq: "==", ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in"}


class Fault(NamedTuple):
    """A place in a line of a file, what replaces it, and the kind of the fault."""

    path: str
    line: int
    begin: int
    end: int
    text: str
    kind: str


def faults_of(path: str) -> Iterator[Fault]:
    """Yield every fault that can be planted in a file."""
    source = (ROOT / path).read_text()
    lines, tree = source.splitlines(), ast.parse(source)
    skipped = {
        inside
        for node in ast.walk(tree)
        for part in (*_annotations(node), *([node] if isinstance(node, ast.JoinedStr | ast.Raise) else []))
        for inside in ast.walk(part)
    }
    for node in ast.walk(tree):
        if node in skipped:
            continue
        for begin, end, text, kind in _changes(node, lines):
            if begin[0] == end[0] and not lines[begin[0] - 1].lstrip().startswith("logger."):
                yield Fault(path, begin[0], begin[1], end[1], text, kind)


def _annotations(node: ast.AST) -> list[ast.expr]:
    found = [getattr(node, name, None) for name in ("annotation", "returns")]
    return [one for one in found if isinstance(one, ast.expr)]


Place = tuple[int, int]


def _changes(node: ast.AST, lines: Sequence[str]) -> Iterator[tuple[Place, Place, str, str]]:
    """Yield the begin and end of what one node has replaced, its new text, and the kind."""
    match node:
        case ast.BinOp(left, operator, right) if type(operator) in OPERATORS:
            yield *_between(left, right, lines), f" {OPERATORS[type(operator)]} ", "operator"
        case ast.UnaryOp(ast.USub(), operand) if not isinstance(operand, ast.Constant):
            yield _begin(node), _begin(operand), "", "operator"
        case ast.Compare(left, [operator], [right]):
            kinds = (("bound", BOUNDS), ("branch", OPPOSITES))
            for kind, texts in kinds:
                if type(operator) in texts and (kind == "branch" or not _is_threshold(right)):
                    yield *_between(left, right, lines), f" {texts[type(operator)]} ", kind
        case ast.Constant(bool(value)):
            yield _begin(node), _end(node), str(not value), "constant"
        case ast.Constant(int(value)):
            yield _begin(node), _end(node), str(value + 1 if value < 5 else 3 * value), "constant"
        case ast.Constant(float(value)):
            yield _begin(node), _end(node), repr(4.0 * value or 1.0), "constant"
        case ast.If(test) | ast.IfExp(test) | ast.While(test) | ast.comprehension(ifs=[test]):
            yield (
                _begin(test),
                _end(test),
                f"(not ({lines[test.lineno - 1][test.col_offset : test.end_col_offset]}))",
                "branch",
            )
        case ast.BoolOp(operator, [first, second, *_]):
            text = " or " if isinstance(operator, ast.And) else " and "
            yield *_between(first, second, lines), text, "branch"
        case ast.Expr(ast.Call()) | ast.AugAssign() | ast.Continue() | ast.Break():
            yield _begin(node), _end(node), "pass", "left out"


def _is_threshold(node: ast.expr) -> bool:
    """Return whether a node is a constant that a floating-point number equals by chance only."""
    if isinstance(node, ast.BinOp):
        return _is_threshold(node.left) or _is_threshold(node.right)
    if isinstance(node, ast.Name):
        return node.id.isupper()
    return isinstance(node, ast.Constant) and isinstance(node.value, float)


def _begin(node: ast.expr | ast.stmt) -> Place:
    return node.lineno, node.col_offset


def _end(node: ast.expr | ast.stmt) -> Place:
    return node.end_lineno or 0, node.end_col_offset or 0


def _between(left: ast.expr, right: ast.expr, lines: Sequence[str]) -> tuple[Place, Place]:
    """Return where an operator stands, without the parentheses of its operands; nowhere if lines end there."""
    (line, begin), (last, end) = _end(left), _begin(right)
    gap = lines[line - 1][begin:end] if line == last else "("
    begin += len(gap) - len(gap.lstrip(") "))
    end -= len(gap) - len(gap.rstrip("( "))
    return (line, begin), (last if begin < end else 0, end)


def planted(fault: Fault) -> str:
    """Return the source of a file with a fault."""
    lines = (ROOT / fault.path).read_text().splitlines(keepends=True)
    line = lines[fault.line - 1].encode()
    lines[fault.line - 1] = (line[: fault.begin] + fault.text.encode() + line[fault.end :]).decode()
    return "".join(lines)


def drawn(number: int, seed: int, wings: Sequence[str]) -> list[Fault]:
    """Draw faults, equally often from each wing and of each kind; every one can be compiled."""
    generator, found = random.Random(seed), dict[Fault, None]()
    pools: dict[tuple[str, str], list[Fault]] = {}
    for wing in wings:
        for path in sorted((ROOT / wing).rglob("*.py")) or [ROOT / wing]:
            for fault in faults_of(str(path.relative_to(ROOT))):
                pools.setdefault((wing, fault.kind), []).append(fault)
    keys = sorted(pools)
    while len(found) < number:
        fault = generator.choice(pools[generator.choice(keys)])
        try:
            compile(planted(fault), fault.path, "exec")
        except SyntaxError:
            continue
        found[fault] = None
    return list(found)


class Recorder:
    """Records for a run of pytest which tests cover which lines, how long each takes, and which fail."""

    def __init__(self) -> None:
        self.coverage = coverage.Coverage(
            data_file=str(KEPT / "coverage"), source=["dsbrdf", SERVICE], config_file=False
        )
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Count what follows for this test."""
        self.coverage.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up the time of a test."""
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if not report.passed:
            self.failed.add(report.nodeid)

    def save(self) -> None:
        """Write the map of lines to tests and the times."""
        self.coverage.stop()
        self.coverage.save()
        good = {test: seconds for test, seconds in self.seconds.items() if test not in self.failed}
        (KEPT / "seconds.json").write_text(json.dumps(good))


def tests_of(wing: str) -> list[str]:
    """Return the folder or the file of a wing's tests, and the files of other wings that test it too."""
    folder = wing.replace(SERVICE, "tests/service").replace("dsbrdf/", "tests/library/")
    above, _, name = folder.rpartition("/")
    own = f"{above}/test_{name}" if name.endswith(".py") else folder
    return [own, *FURTHER_TESTS.get(name.removesuffix(".py"), [])]


def covering(fault: Fault, seconds: dict[str, float], wings: Sequence[str]) -> list[str]:
    """Return tests that cover the line of a fault, or that use the constant which it defines, the quickest first.

    The other tests of the wing follow: what a fixture has computed for many tests is recorded for the first.
    """
    data = coverage.CoverageData(str(KEPT / "coverage"))
    data.read()
    contexts = data.contexts_by_lineno(str(ROOT / fault.path))
    lines = (ROOT / fault.path).read_text().splitlines()
    name = lines[fault.line - 1].partition(" ")[0].rstrip(":")
    used = [fault.line, *(n for n, line in enumerate(lines, 1) if name.isidentifier() and name in line)]
    wing = tuple(next(tests_of(wing) for wing in wings if fault.path.startswith(wing)))
    tests = {test for line in used for test in contexts.get(line, ()) if test in seconds}
    others = [test for test in seconds if test.startswith(wing) and test not in tests]
    chosen, total = [], 0.0
    for test in (*sorted(tests, key=seconds.__getitem__), *sorted(others, key=seconds.__getitem__)):
        total += seconds[test]
        if total <= MAX_TEST_SECONDS:
            chosen.append(test)
    return chosen


def is_noticed(fault: Fault, tests: Sequence[str], copy: Path) -> bool:
    """Run tests with a fault in the copy, in a fork of this process; return whether one fails."""
    path = copy / fault.path
    original = path.read_text()
    path.write_text(planted(fault))
    child = os.fork()
    if child == 0:
        os.setsid()
        run_tests(copy, tests)
    try:
        return ended(child) != 0
    finally:
        path.write_text(original)


def run_tests(copy: Path, tests: Sequence[str]) -> NoReturn:
    """Run tests of the copy in this process, quietly, and end it with the exit code."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nothing, descriptor)
    os.chdir(copy)
    paths = [str(copy), str(copy / "service")]
    os.environ["PYTHONPATH"] = ":".join(paths)
    sys.path[:0], sys.dont_write_bytecode = paths, True
    for name in [name for name in sys.modules if name.split(".")[0] in OWN_PACKAGES]:
        del sys.modules[name]
    code: int = 1
    try:
        flags = ["-q", "-x", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
        code = pytest.main([*flags, *tests])
    finally:
        os._exit(code)


def ended(child: int) -> int:
    """Wait for a process with a session of its own, and kill it after a time; return its exit code."""
    deadline = time.monotonic() + MAX_RUN_SECONDS
    while time.monotonic() < deadline:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def record(wings: Sequence[str]) -> None:
    """Run the tests of wings in a fork, because the tests leave traces in their process; keep what they cover."""
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        return
    KEPT.mkdir(parents=True, exist_ok=True)
    recorder = Recorder()
    recorder.coverage.start()
    places = {place for wing in wings for place in tests_of(wing) if (ROOT / place).exists()}
    pytest.main(["-q", "-p", "no:cacheprovider", *places], plugins=[recorder])
    recorder.save()
    os._exit(0)


def main(argv: Sequence[str]) -> int:
    """Print each fault that is not noticed, and how many are."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks faults", description=__doc__)
    parser.add_argument("--number", type=int, default=150, metavar="N", help="faults (default: 150)")
    parser.add_argument("--seed", type=int, default=1, help="of the choice (default: 1)")
    about = f"folders or files of the packages (default: {', '.join(WINGS)})"
    parser.add_argument("--only", nargs="+", default=WINGS, metavar="WING", help=about)
    parser.add_argument("--show", action="store_true", help="print the faults, and run no test")
    arguments = parser.parse_args(argv)
    faults = drawn(arguments.number, arguments.seed, arguments.only)
    if not arguments.show and not (KEPT / "seconds.json").exists():
        record(arguments.only)
    seconds: dict[str, float] = {} if arguments.show else json.loads((KEPT / "seconds.json").read_text())
    n_noticed = 0
    for name in PRELOADED:
        import_module(name)
    folder = Path(tempfile.mkdtemp(prefix="dsbrdf-"))  # A `TemporaryDirectory` would be removed by a fork that exits.
    copy = folder / "copy"
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in names.splitlines():
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, copy / name)
    if not arguments.show:
        unchanged = faults[0]._replace(begin=0, end=0, text="")
        if is_noticed(unchanged, covering(unchanged, seconds, arguments.only), copy):
            raise SystemExit(f"a test fails without a fault; remove {KEPT} to record the tests anew")
    for number, fault in enumerate(faults, 1):
        begin = time.monotonic()
        tests = covering(fault, seconds, arguments.only) if seconds else []
        noticed = not arguments.show and is_noticed(fault, tests, copy)
        n_noticed += noticed
        line, after = ((ROOT / fault.path).read_text(), planted(fault))
        before, after = (text.splitlines()[fault.line - 1].strip() for text in (line, after))
        verdict = "planted" if arguments.show else "noticed" if noticed else "NOT NOTICED"
        where = f"{number:3} {fault.path}:{fault.line} {fault.kind}"
        print(
            f"{where}: {verdict} ({len(tests)} tests, {time.monotonic() - begin:.0f} s)\n    {before}\n    {after}",
            flush=True,
        )
    shutil.rmtree(folder)
    print(f"{n_noticed} of {len(faults)} faults noticed")
    return 0
