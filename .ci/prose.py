"""Refuse comments and names of constants that a first reader cannot understand.

These are the rules of CONTRIBUTING.md that need no judgement: no comment goes on from a name with "of", "which",
"that", "to", "with" or "by"; no constant is named by a bare word like MOST; a line defines one constant.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

TOP = Path(__file__).parent.parent
FOLDERS = (".ci", "benchmarks", "docker", "docs", "dsbrdf", "examples", "service", "tests")
SUFFIXES = {".py", ".js", ".css", ".ts", ".html", ".sh", ".conf", ".yaml", ".yml", ""}
SKIPPED_FOLDERS = {"__pycache__", "_build", "generated", "stored", "cases"}

DANGLING_COMMENT = re.compile(r"(?:#|//|/\*)+ ?(?:of|which|that|to|with|by)\b")
BARE_WORDS = re.compile(
    r"_*(?:MOST|LEAST|LARGEST|SMALLEST|LONGEST|SHORTEST|BRIGHTEST|DARKEST|WIDEST|NARROWEST|FASTEST|"
    r"SLOWEST|FEW|FEWEST|MANY|MORE|LESS|ENOUGH|STEP|STEPS|BLOCK|BLOCKS|DARK|FAR|NEAR|FAINT|"
    r"PROBABLE|SMALL|LARGE|SHORT|LONG|BRIGHT|WIDE|NARROW|FLAT|STEEP|SHARP|SMOOTH|SLOW|"
    r"FAST|GOOD|CLOSE|SECONDS|TIMES|ROUNDS|TRIES|SHARE|SHARES)"
)


def main() -> int:
    """Print every fault and return the exit code."""
    faults = [fault for path in _sources() for fault in faults_of(path)]
    sys.stdout.write("".join(f"{fault}\n" for fault in faults))
    return 1 if faults else 0


def faults_of(path: Path) -> list[str]:
    """Return a line for each fault of a file."""
    text = path.read_text(encoding="utf-8")
    found = [(number, "this comment goes on from a name: write a sentence") for number in dangling_comments(path, text)]
    if path.suffix == ".py":
        found += bad_constants(ast.parse(text))
    return [f"{path.relative_to(TOP)}:{number}: {fault}" for number, fault in sorted(found)]


def dangling_comments(path: Path, text: str) -> Iterator[int]:
    """Yield the lines of comments that begin in the middle of a sentence."""
    lines = text.splitlines()
    comments = _python_comments(text) if path.suffix == ".py" else _other_comments(lines)
    for number, column in comments:
        if DANGLING_COMMENT.match(lines[number - 1], column) and not _continues(lines, number, column):
            yield number


def bad_constants(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the lines of constants without a scope in their names, and of several constants."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [name for target in targets for name in _constants(target)]
        if len(names) > 1 and (len(targets) > 1 or isinstance(node.value, ast.Tuple)):
            yield node.lineno, f"{', '.join(names)}: define one constant a line"
        for name in names:
            if BARE_WORDS.fullmatch(name):
                yield node.lineno, f"{name}: name the quantity, its scope and its unit"


def _constants(target: ast.expr) -> list[str]:
    names = target.elts if isinstance(target, ast.Tuple) else [target]
    return [name.id for name in names if isinstance(name, ast.Name) and re.fullmatch(r"_?[A-Z][A-Z0-9_]{2,}", name.id)]


def _python_comments(text: str) -> Iterator[tuple[int, int]]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start


def _other_comments(lines: list[str]) -> Iterator[tuple[int, int]]:
    for number, line in enumerate(lines, 1):
        if found := re.search(r"(?:^|(?<=\s))(?:#|//|/\*) ", line):
            yield number, found.start()


def _continues(lines: list[str], number: int, column: int) -> bool:
    """Whether a comment that fills its line goes on from one on the line above."""
    above, line = lines[number - 2] if number > 1 else "", lines[number - 1]
    return not line[:column].strip() and above.lstrip().startswith(line[column])


def _sources() -> Iterator[Path]:
    yield TOP / "Makefile"
    for folder in FOLDERS:
        for path in sorted((TOP / folder).rglob("*")):
            inside = path.relative_to(TOP)
            if path.is_file() and path.suffix in SUFFIXES and not SKIPPED_FOLDERS & set(inside.parts):
                yield path


if __name__ == "__main__":
    sys.exit(main())
