"""Every command of README, CONTRIBUTING and docs runs as it stands there, or is marked with the reason why not here."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

from spinbench.cli import app
from tests.documented_commands import (
    FENCE,
    KINDS,
    PAGES,
    ROOT,
    Command,
    commands,
    commands_of,
    fresh_copy,
    not_in,
    run_page,
)

COMMANDS = commands()
TAKES_LONG = ("docs/commands.md", "docs/tutorials/from-a-logger.md", "docs/tutorials/manual-bench.md")
QUICK = [command for command in COMMANDS if command.kinds <= {"background"}]
INDENTED = re.compile(r"^(?: {4}|\t)(?:spinbench|make|python|dask) ", re.MULTILINE)


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.long] if page in TAKES_LONG else [])
        for page in dict.fromkeys(command.page for command in QUICK)
    ],
)
def test_the_commands_of_a_page_give_what_the_page_says(tmp_path: Path, page: str) -> None:
    copy = tmp_path / "copy"
    fresh_copy(copy, kernels=True)
    where = Command(page, 0, 'python -c "import spinbench; print(spinbench.__file__)"', shown=[str(copy)])
    wrong = run_page([where, *(command for command in QUICK if command.page == page)], copy, longest_s=120.0)
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("command", [command for command in COMMANDS if command not in QUICK], ids=str)
def test_a_command_that_does_not_run_here_says_why(command: Command) -> None:
    assert command.kinds <= set(KINDS)
    assert len(command.reason.split()) >= 2


def test_all_but_these_run_somewhere() -> None:
    assert {command.text for command in COMMANDS if command.kinds & {"hardware", "person", "network", "yours"}} == {
        "make setup",
        "python3 -m venv ~/spinbench",
        '~/spinbench/bin/pip install ".[cluster,formats,mdf,mqtt,notebook,opcua,seal]"',
        "spinbench doctor configs/benches/lab.toml",
        "spinbench sweep configs/benches/lab.toml",
        "spinbench sweep configs/benches/manual.toml",
        "spinbench diagnose --continue out/diagnosis last -o out/both",
        "spinbench diagnose --continue out/monday recordings/flywheel -o out/both",
        "spinbench diagnose recordings/monday recordings/friday -o out/both",
        "spinbench compare recordings/may recordings/june -o out/since",
        "spinbench trend logs -o out/history",
    }


@pytest.mark.parametrize("page", PAGES)
def test_a_mark_stands_before_a_block(page: str) -> None:
    text = text_of(page)
    used = "".join(re.findall(r"((?:<!-- run: .+ -->\n)+)\n```sh\n", text))
    assert used.count("<!-- run:") == len(re.findall("^<!-- run:", text, re.MULTILINE))


@pytest.mark.parametrize("page", PAGES)
def test_no_command_stands_where_it_is_not_run(page: str) -> None:
    languages = {fence[2] for fence in map(FENCE.match, text_of(page).splitlines()) if fence}
    assert not languages & {"bash", "console", "shell"}
    assert not INDENTED.search(text_of(page))


@pytest.mark.parametrize("page", PAGES)
def test_a_command_named_in_a_sentence_exists_with_its_options(page: str) -> None:
    for span in re.findall(r"`spinbench ([^`]+)`", text_of(page).replace("\n", " ")):
        command = typer.main.get_command(app)
        words = span.split()
        while hasattr(command, "commands") and words and words[0] in command.commands:
            command = command.commands[words.pop(0)]
        options = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        assert not hasattr(command, "commands") or not words or words[0].startswith("-"), span
        assert {word.partition("=")[0] for word in words if word.startswith("-")} <= options | {"--help"}, span


@pytest.mark.parametrize("command", COMMANDS, ids=str)
def test_a_page_says_what_a_command_gives(command: Command) -> None:
    ours = command.text.startswith("spinbench") and not command.kinds & {"hardware", "person", "hours"}
    if ours or "background" in command.kinds:  # how else would one know that it serves
        assert command.shown


PAGE = """
<!-- run: long 2: takes a minute -->

```sh
printf 'the speed is 397.06 rpm,  │ done'   # -> the speed is about 397.05 rpm, done
sleep 60
false
# exit code 1: it is false
```

```text
never said
```

    make nothing
"""


def test_a_page_is_read_line_by_line() -> None:
    first, second, third = commands_of("a.md", PAGE)
    assert (first.line, second.line, third.line) == (5, 6, 7)
    assert (second.kinds, second.reason) == ({"long"}, "takes a minute")
    assert (third.status, third.shown) == (1, ["never said"])
    assert not first.kinds | third.kinds


def test_what_is_not_as_the_page_says_is_found(tmp_path: Path) -> None:
    first, _, third = commands_of("a.md", PAGE)
    wrong = run_page([first, third, Command("a.md", 9, "true", status=2)], tmp_path, 10.0)
    assert [text.partition("'")[0].partition(": exit")[0] for text in wrong] == [
        "a.md:7: false: does not say ",
        "a.md:9: true",
    ]


@pytest.mark.parametrize(
    ("output", "shown", "missing"),
    [
        ("speed   397.06 rpm\nflow 72.88", "speed 397.06 ... 72.88", None),
        ("speed   397.06 rpm\nflow 72.88", "speed 397.… rpm … 72.88", None),
        ("speed   397.06 rpm\nflow 72.88", "72.88 ... 397.06", "397.06"),
        ("f_overall is 0.0639 ± 0.0023", "f_overall is about 0.0638 ± 0.0023", None),
        ("f_overall is 0.0640 ± 0.0023", "f_overall is about 0.0638 ± 0.0023", "f_overall is about 0.0638 ± 0.0023"),
    ],
)
def test_what_a_page_shows_is_compared_with_the_output(output: str, shown: str, missing: str | None) -> None:
    assert not_in(output, shown) == missing
