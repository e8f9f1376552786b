"""Measure the code base: how much of it there is, what has grown too large, and what imports in circles.

    python scripts/house.py            a table in Markdown: what is aimed at, what is, and what was before the rebuild
    python scripts/house.py --list     the offenders of each row below it

The standard library alone is needed. Import contracts are counted where import-linter is installed.
"""

from __future__ import annotations

import argparse
import ast
import functools
import io
import os
import re
import shutil
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("spinbench", "rig", "model", "calibration", "configs")
NO_PRODUCT = ("calibration/studies",)
MOST_LINES, MOST_DOCSTRING_PERCENT = 44_000, 20
MOST_CODE_LINES, MOST_LONG_FUNCTIONS = 40, 10
MOST_ARGUMENTS, MOST_WIDE_FUNCTIONS = 8, 12
MOST_FILE_LINES, MOST_FILES_A_FOLDER = 400, 15
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
NOT_AT_IMPORT = re.compile(r"\bTYPE_CHECKING\b|\b__name__ == '__main__'")

Function = ast.FunctionDef | ast.AsyncFunctionDef
Imports = dict[str, frozenset[str]]  # module to modules


@dataclass(frozen=True)
class Row:
    """A line of the table, and the offenders that are listed below it."""

    what: str
    aim: str
    is_now: str
    was: str
    offenders: tuple[str, ...] = ()


@dataclass(frozen=True)
class Source:
    """A Python file: its path from the root, and its text."""

    path: Path
    text: str

    @functools.cached_property
    def tree(self) -> ast.Module:
        """What the parser makes of it."""
        return ast.parse(self.text)

    @property
    def folder(self) -> str:
        """The folder that it lies in, from the root."""
        return self.path.parent.as_posix()

    @property
    def module(self) -> str:
        """Its name as a module; a package's ``__init__`` has the name of the package."""
        parts = self.path.with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    @property
    def lines(self) -> int:
        """Its lines."""
        return len(self.text.splitlines())

    @functools.cached_property
    def docstring_lines(self) -> frozenset[int]:
        """Numbers of the lines that docstrings of the module, its classes and its functions stand on."""
        found: set[int] = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Module | ast.ClassDef | Function) and ast.get_docstring(node) is not None:
                first = node.body[0]
                found.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
        return frozenset(found)

    @functools.cached_property
    def code_lines(self) -> frozenset[int]:
        """Numbers of the lines that hold code: no docstring, not blank, not a comment alone."""
        found: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            if token.type not in NO_CODE:
                found.update(range(token.start[0], token.end[0] + 1))
        return frozenset(found) - self.docstring_lines

    def functions(self) -> Iterator[tuple[str, Function]]:
        """Every function and method with its qualified name, those within others too."""
        yield from _functions(self.tree, "")


def _functions(node: ast.AST, before: str) -> Iterator[tuple[str, Function]]:
    for inner in ast.iter_child_nodes(node):
        name = f"{before}{inner.name}" if isinstance(inner, Function | ast.ClassDef) else before.removesuffix(".")
        if isinstance(inner, Function):
            yield name, inner
        yield from _functions(inner, f"{name}." if name else "")


def read_sources(root: Path, folders: Iterable[str], without: Sequence[str] = ()) -> list[Source]:
    """The Python files below folders of a tree, sorted by path."""
    found = []
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            relative = path.relative_to(root)
            if not any(relative.is_relative_to(one) for one in without):
                found.append(Source(relative, path.read_text(encoding="utf-8")))
    return found


def long_functions(sources: Iterable[Source]) -> list[tuple[int, str]]:
    """Functions of more lines of code than that, the longest first."""
    found = []
    for source in sources:
        for name, function in source.functions():
            span = range(function.lineno, (function.end_lineno or function.lineno) + 1)
            count = len(source.code_lines.intersection(span))
            if count > MOST_CODE_LINES:
                found.append((count, _place(source, name, function)))
    return sorted(found, reverse=True)


def wide_functions(sources: Iterable[Source]) -> list[tuple[int, str]]:
    """Functions of more arguments than that, the widest first; ``self`` and ``cls`` are none."""
    found = []
    for source in sources:
        for name, function in source.functions():
            given = function.args
            names = [one.arg for one in (*given.posonlyargs, *given.args)]
            count = len(names) - (names[:1] in (["self"], ["cls"])) + len(given.kwonlyargs)
            count += (given.vararg is not None) + (given.kwarg is not None)
            found.append((count, _place(source, name, function)))
    return sorted((one for one in found if one[0] > MOST_ARGUMENTS), reverse=True)


def is_compiled(function: Function) -> bool:
    """Whether a function is a kernel that numba compiles."""
    decorators = (one.func if isinstance(one, ast.Call) else one for one in function.decorator_list)
    return any(ast.unparse(one).rpartition(".")[2] == "njit" for one in decorators)


def _place(source: Source, name: str, function: Function) -> str:
    mark = " (compiled kernel)" if is_compiled(function) else ""
    return f"{source.path.as_posix()}:{function.lineno} {name}{mark}"


def long_files(sources: Iterable[Source]) -> list[tuple[int, str]]:
    """Files of more lines than that, the longest first."""
    return sorted(((one.lines, one.path.as_posix()) for one in sources if one.lines > MOST_FILE_LINES), reverse=True)


def full_folders(sources: Iterable[Source]) -> list[tuple[int, str]]:
    """Folders of more modules than that, the fullest first; ``__init__`` is none."""
    count = Counter(one.folder for one in sources if one.path.name != "__init__.py")
    return sorted(((many, folder) for folder, many in count.items() if many > MOST_FILES_A_FOLDER), reverse=True)


def imports_of(sources: Sequence[Source]) -> Imports:
    """Which of these modules each imports when it is imported itself.

    Not in a function, for the type checker alone, or where it is run as a program.
    """
    known = {one.module for one in sources}
    return {one.module: frozenset(_imported(one, known) - {one.module}) for one in sources}


def _imported(source: Source, known: set[str]) -> set[str]:
    found: set[str] = set()
    for node in _at_import(source.tree.body):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        else:
            place = _absolute(source, node)
            names = {f"{place}.{alias.name}" for alias in node.names}
            found |= names
            if names - known:  # something that the place itself holds
                found.add(place)
    return found & known


def _at_import(body: Sequence[ast.stmt]) -> Iterator[ast.Import | ast.ImportFrom]:
    for node in body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif isinstance(node, ast.If) and NOT_AT_IMPORT.search(ast.unparse(node.test)):
            yield from _at_import(node.orelse)
        elif not isinstance(node, Function):
            for part in ("body", "orelse", "finalbody"):
                yield from _at_import(getattr(node, part, []))
            for handler in getattr(node, "handlers", []):
                yield from _at_import(handler.body)


def _absolute(source: Source, node: ast.ImportFrom) -> str:
    if not node.level:
        return node.module or ""
    package = source.path.parent.parts
    return ".".join([*package[: len(package) - node.level + 1], *([node.module] if node.module else [])])


def circles(imports: Imports) -> list[tuple[str, ...]]:
    """Sets of modules each of which imports itself by way of the others, sorted."""
    reached = {module: _reached(imports, module) for module in imports}
    rings = {tuple(sorted(o for o in reached[m] if m in reached[o])) for m in imports if m in reached[m]}
    return sorted(rings)


def _reached(imports: Imports, start: str) -> set[str]:
    found: set[str] = set()
    left = list(imports[start])
    while left:
        module = left.pop()
        if module not in found:
            found.add(module)
            left += imports[module]
    return found


def both_ways(sources: Sequence[Source], imports: Imports) -> list[tuple[str, str]]:
    """Pairs of folders of which each holds a module that imports one of the other, sorted."""
    folder = {one.module: one.folder for one in sources}
    pairs = {(folder[module], folder[other]) for module, others in imports.items() for other in others}
    return sorted((a, b) for a, b in pairs if a < b and (b, a) in pairs)


def contracts(root: Path) -> str:
    """How many import contracts are kept, of how many; empty where import-linter is not there to say."""
    places = (Path(sys.executable).parent, root / ".venv" / "bin")
    command = next(filter(None, (shutil.which("lint-imports", path=str(place)) for place in places)), None)
    if command is None:
        return ""
    environment = {**os.environ, "PYTHONPATH": str(root)}
    ran = subprocess.run([command, "--no-cache"], cwd=root, env=environment, capture_output=True, text=True)
    told = re.search(r"Contracts: (\d+) kept, (\d+) broken", ran.stdout)
    return f"{told[1]} of {int(told[1]) + int(told[2])}" if told else ""


def measure(root: Path) -> list[Row]:
    """All rows of the table, for the tree at a root."""
    sources = read_sources(root, PACKAGES, NO_PRODUCT)
    tests = read_sources(root, ["tests"])
    lines = sum(one.lines for one in sources)
    docstrings = sum(len(one.docstring_lines) for one in sources)
    imports = imports_of(sources)
    counted = [
        (f"functions over {MOST_CODE_LINES} lines of code", MOST_LONG_FUNCTIONS, long_functions(sources), 35),
        (f"functions with more than {MOST_ARGUMENTS} arguments", MOST_WIDE_FUNCTIONS, wide_functions(sources), 29),
        (f"files over {MOST_FILE_LINES} lines", 0, long_files(sources), 9),
        (f"folders with more than {MOST_FILES_A_FOLDER} modules", 0, full_folders(sources), 5),
    ]
    pairs = tuple(f"{a} and {b}" for a, b in both_ways(sources, imports))
    rings = tuple(", ".join(ring) for ring in circles(imports))
    kept = contracts(root)
    return [
        Row("product lines", f"at most {MOST_LINES}", str(lines), "60300"),
        Row(
            "share of docstring lines",
            f"at most {MOST_DOCSTRING_PERCENT} %",
            f"{100 * docstrings / max(lines, 1):.0f} %",
            "31 %",
        ),
        *(
            Row(what, f"at most {aim}" if aim else "0", str(len(found)), str(was), tuple(f"{n} {w}" for n, w in found))
            for what, aim, found, was in counted
        ),
        Row("pairs of folders that import each other", "0", str(len(pairs)), "12", pairs),
        Row("circles of modules", "0", str(len(rings)), "1", rings),
        *([Row("import contracts kept", "all", kept, "")] if kept else []),
        Row("lines of tests", "", str(sum(one.lines for one in tests)), ""),
        Row("product modules", "", str(sum(one.path.name != "__init__.py" for one in sources)), ""),
    ]


def as_markdown(rows: Iterable[Row], with_offenders: bool = False) -> str:
    """The table; with offenders a list follows below it for each row that has some."""
    lines = ["| what | aim | is | was |", "|---|---|---|---|"]
    below = []
    for row in rows:
        lines.append(f"| {row.what} | {row.aim} | {row.is_now} | {row.was} |")
        if with_offenders and row.offenders:
            below += ["", f"{row.what[0].upper()}{row.what[1:]}:", "", *(f"- {one}" for one in row.offenders)]
    return "\n".join([*lines, *below])


def main() -> int:
    """Print the table; the exit code is 0 whatever it says."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("--list", action="store_true", help="the offenders of each row, below the table")
    asked.add_argument("--root", type=Path, default=ROOT, help="the tree to measure; this one when left out")
    given = asked.parse_args()
    print(as_markdown(measure(given.root.resolve()), given.list))
    return 0


if __name__ == "__main__":
    sys.exit(main())
