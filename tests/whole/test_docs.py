"""The documentation: links lead somewhere, commands in it exist, and its table of priors is the code's."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest
import typer

from calibration.fit import fit
from rig.recording import read_recording
from spinbench.cli import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(ROOT.glob("docs/**/*.md"))
LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PRIORS = {"normal": "normal, {a:g} ± {b:g}", "lognormal": "log-normal, {a:g} ×÷ {b:g}"}
PRIORS |= {"loguniform": "log-uniform, {a:g} to {b:g}"}


def text_of(page):
    return page.read_text(encoding="utf-8")


def is_utf8(file):
    try:
        file.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def links():
    for page in PAGES:
        for target in LINK.findall(text_of(page)):
            if not re.match(r"[a-z]+:", target):
                yield page, target


def anchors(page):
    """What a heading of a page is called in a link, as GitHub makes it."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", text_of(page)), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", LINK.sub("]", heading).lower()).replace(" ", "-") for heading in headings}


def command_lines():
    text = text_of(ROOT / "README.md") + text_of(ROOT / "docs" / "commands.md")
    blocks = (body for language, body in FENCE.findall(text) if language == "sh")
    lines = [line.partition(" #")[0].strip() for body in blocks for line in body.splitlines()]
    return [line for line in lines if line.startswith("spinbench ")]


@pytest.mark.parametrize(("page", "target"), list(links()), ids=lambda part: getattr(part, "name", part))
def test_a_relative_link_leads_to_a_file_and_a_heading_in_it(page, target):
    file, _, heading = target.partition("#")
    there = page.parent / file if file else page
    assert there.exists()
    assert not heading or heading in anchors(there)


@pytest.mark.parametrize("page", sorted(ROOT.glob("docs/tutorials/*.md")), ids=lambda page: page.name)
def test_a_file_that_a_tutorial_shows_is_the_one_beside_it(page):
    beside = {text_of(file) for ending in ("toml", "csv") for file in page.parent.glob(f"*.{ending}") if is_utf8(file)}
    assert {body for language, body in FENCE.findall(text_of(page)) if language in ("toml", "csv")} <= beside


def test_the_index_links_every_page():
    index = ROOT / "docs" / "index.md"
    linked = {(index.parent / target.partition("#")[0]).resolve() for page, target in links() if page == index}
    assert set(PAGES) - {index} <= linked


def test_every_command_is_shown():
    shown = {shlex.split(line)[1] for line in command_lines()}
    assert shown == set(typer.main.get_command(app).commands)


@pytest.mark.parametrize("line", command_lines())
def test_a_command_line_of_the_readme_or_of_all_commands_parses(line):
    _, name, *arguments = shlex.split(line)
    command = typer.main.get_command(app).commands[name]
    command.make_context(name, arguments)  # a UsageError when an option or a value is not known


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_make_targets_named_in_a_page_exist(page):
    targets = set(re.findall(r"^([\w-]+):", text_of(ROOT / "Makefile"), re.MULTILINE))
    assert {"demo", "test"} <= targets
    assert set(re.findall(r"^make ([\w-]+)|`make ([\w-]+)`", text_of(page), re.MULTILINE)) <= {
        pair for target in targets for pair in ((target, ""), ("", target))
    }


def test_the_citation_is_of_this_version():
    version = tomllib.loads(text_of(ROOT / "pyproject.toml"))["project"]["version"]
    assert f"\nversion: {version}\n" in text_of(ROOT / "CITATION.cff")


def test_the_table_of_priors_is_the_codes():
    found = fit.prepare(read_recording(ROOT / "logs" / "published_sweep"))[2].unknowns
    rows = [f"| `{u.name}` | {u.unit} | {PRIORS[u.kind].format(a=u.a, b=u.b)} |" for u in found]
    page = text_of(ROOT / "docs" / "fit.md")
    assert page.partition("<!-- priors")[2].partition("\n\n")[0].splitlines()[3:] == rows


def test_the_record_is_told_as_it_was_scored():
    record = json.loads(text_of(ROOT / "docs" / "challenge" / "result.json"))
    section = text_of(ROOT / "docs" / "challenge.md").partition("## The record\n")[2].partition("\n## ")[0]
    told = [line.split("|") for line in section.splitlines() if line.startswith("| ")][1:]
    got, met = "\n".join(row[3] for row in told), sorted(row[4].partition(":")[0].partition(",")[0] for row in told)
    for goal in record["goals"]:
        share = goal["got"]
        wanted = f" {share['hits']} of {share['n']} " if share else f" {100 * goal['ratio']:.1f} % "
        assert wanted in got, goal["goal"]
    assert [word.strip() for word in met] == sorted(goal["met"] for goal in record["goals"])
    assert f"{record['cases']} cases in thirteen parts" in text_of(ROOT / "README.md").replace("\n", " ")
    assert len(record["campaigns"]) == 13
