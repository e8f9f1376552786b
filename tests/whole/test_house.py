"""What `make house` measures: right on small sources, and no circle in this tree."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from scripts import house

ROOT = Path(__file__).resolve().parents[2]


def tree(folder: Path, files: dict[str, str]) -> list[house.Source]:
    """Sources of a package ``pack``, by their paths in it without the ending."""
    for name, text in files.items():
        path = folder / "pack" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return house.read_sources(folder, ["pack"])


def function_of(code_lines: int) -> str:
    """A function of so many lines of code, its first and last with them, and of other lines beside."""
    other = '    """What it does.\n\n    At length.\n    """\n\n    # a comment alone\n'
    return f"def f():\n{other}" + "    x = 1  # a comment beside\n" * (code_lines - 2) + "    return x\n"


def circles_of(sources: list[house.Source]) -> list[tuple[str, ...]]:
    return house.circles(house.imports_of(sources))


def pairs_of(sources: list[house.Source]) -> list[tuple[str, str]]:
    return house.both_ways(sources, house.imports_of(sources))


def test_a_function_of_41_lines_of_code_is_found_and_one_of_40_is_not(tmp_path: Path) -> None:
    sources = tree(tmp_path, {"short": function_of(40), "long": function_of(41)})
    assert house.long_functions(sources) == [(41, "pack/long.py:1 f")]


def test_every_line_of_a_text_that_is_no_docstring_is_code(tmp_path: Path) -> None:
    sources = tree(tmp_path, {"text": 'def f():\n    return """' + "\n" * 39 + '"""\n'})
    assert house.long_functions(sources) == [(41, "pack/text.py:1 f")]


def test_a_method_has_the_name_of_its_class(tmp_path: Path) -> None:
    body = "".join(f"    {line}\n" for line in function_of(41).splitlines())
    assert house.long_functions(tree(tmp_path, {"method": f"class C:\n{body}"})) == [(41, "pack/method.py:2 C.f")]


def test_arguments_are_counted_without_self(tmp_path: Path) -> None:
    eight, nine = ", ".join("abcdefgh"), "a, b, c, d, e, f, *, g, h, i"
    text = f"class C:\n    def eight(self, {eight}): ...\n    def nine(self, {nine}): ...\n"
    assert house.wide_functions(tree(tmp_path, {"wide": text})) == [(9, "pack/wide.py:3 C.nine")]


@pytest.mark.parametrize("decorator", ["njit", "njit(cache=True)", "numba.njit(cache=True)"])
def test_a_compiled_kernel_is_marked(tmp_path: Path, decorator: str) -> None:
    sources = tree(tmp_path, {"kernel": f"@{decorator}\ndef f({', '.join('abcdefghi')}): ...\n"})
    assert house.wide_functions(sources) == [(9, "pack/kernel.py:2 f (compiled kernel)")]


def test_docstring_lines_are_those_of_modules_classes_and_functions(tmp_path: Path) -> None:
    text = '"""Module,\nof two lines."""\n\nX = """no docstring"""\n\n\nclass C:\n    """Class."""\n\n    y: int\n'
    text += '    """What is said of an attribute."""\n\n    def f(self):\n        """Function."""\n'
    (source,) = tree(tmp_path, {"documented": text})
    assert source.docstring_lines == {1, 2, 8, 14}
    assert source.lines == 14


def test_long_files_and_full_folders_are_found(tmp_path: Path) -> None:
    files = {f"full/m{i}": "" for i in range(16)} | {f"just/m{i}": "" for i in range(15)}
    files |= {"full/__init__": "", "just/__init__": "", "long": "x = 1\n" * 401, "short": "x = 1\n" * 400}
    sources = tree(tmp_path, files)
    assert house.long_files(sources) == [(401, "pack/long.py")]
    assert house.full_folders(sources) == [(16, "pack/full")]


def test_a_circle_of_three_modules_is_found(tmp_path: Path) -> None:
    sources = tree(
        tmp_path,
        {
            "a": "from pack import b\n",
            "b": "try:\n    import pack.c\nexcept ImportError:\n    pass\n",
            "c": "from .a import something\n",
            "d": "from pack.a import something\n",
        },
    )
    assert circles_of(sources) == [("pack.a", "pack.b", "pack.c")]


@pytest.mark.parametrize(
    "later",
    [
        "def f():\n    from pack import a\n",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from pack import a\n",
        "if __name__ == '__main__':\n    from pack import a\n",
    ],
    ids=["in a function", "for the type checker", "as a program"],
)
def test_what_is_not_imported_with_a_module_makes_no_circle(tmp_path: Path, later: str) -> None:
    assert circles_of(tree(tmp_path, {"a": "from pack import b\n", "b": later})) == []


def test_folders_that_import_each_other_are_found_though_no_modules_do(tmp_path: Path) -> None:
    sources = tree(
        tmp_path,
        {
            "one/__init__": "",
            "one/a": "from pack.two import b\n",
            "one/c": "",
            "two/b": "",
            "two/d": "from pack.one.c import something\nfrom pack.three import e\n",
            "three/e": "",
        },
    )
    assert circles_of(sources) == []
    assert pairs_of(sources) == [("pack/one", "pack/two")]


def test_the_offenders_stand_below_the_table_when_they_are_asked_for() -> None:
    rows = [house.Row("files too long", "0", "1", "2", ("401 a.py",)), house.Row("circles", "0", "0", "1")]
    table = "| what | aim | is | was |\n|---|---|---|---|\n| files too long | 0 | 1 | 2 |\n| circles | 0 | 0 | 1 |"
    assert house.as_markdown(rows) == table
    assert house.as_markdown(rows, True) == f"{table}\n\nFiles too long:\n\n- 401 a.py"


def test_this_tree_has_neither_a_circle_nor_folders_that_import_each_other() -> None:
    sources = house.read_sources(ROOT, house.PACKAGES, house.NO_PRODUCT)
    assert len(sources) > 100
    assert circles_of(sources) == []
    assert pairs_of(sources) == []


LISTED = re.compile(r"\s*([a-z_0-9]+(?:, [a-z_0-9]+)*)\s{2,}\S")


@pytest.mark.parametrize("package", ["calibration", "model", "rig", "spinbench"])
def test_a_room_lists_the_modules_that_it_has(package: str) -> None:
    wrong = []
    for place in sorted((ROOT / package).rglob("__init__.py")):
        text = ast.get_docstring(ast.parse(place.read_text(encoding="utf-8"))) or ""
        there = {one.stem for one in place.parent.glob("*.py")} - {"__init__", "__main__"}
        there |= {one.parent.name for one in place.parent.glob("*/__init__.py")}
        names = [match[1].split(", ") for match in map(LISTED.match, text.splitlines()[1:]) if match]
        listed = {name for one in names for name in one}
        if listed:
            gone, unsaid = sorted(listed - there), sorted(there - set(re.findall(r"[a-z_0-9]+", text)))
            wrong += [f"{place.parent.relative_to(ROOT)}: gone {gone}, not said {unsaid}"] if gone or unsaid else []
    assert wrong == []
