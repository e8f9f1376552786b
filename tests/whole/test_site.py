"""The site of the documentation: strict, in four kinds, and whole without a network."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from docs.conf import INDEX, contents
from tests.browser import installed
from tests.documented_commands import ROOT

KINDS = ["Tutorials", "How to do something", "Explanation", "Reference"]
FETCHED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=\"([^\"]*)\"")
IN_STYLE = re.compile(r"url\(\s*[\"']?([^)\"']*)|@import\s+[\"']([^\"']*)")


def built(source: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """A site as `make site` builds it."""
    switches = ["-q", "-E", "-W", "--keep-going", "-c", source / "docs", "-d", out.with_name("doctrees")]
    return subprocess.run([sys.executable, "-m", "sphinx", *switches, source, out], capture_output=True, text=True)


@pytest.fixture
def two_pages(tmp_path: Path) -> Path:
    """A tree with an index, a page of one heading, and one that begins without."""
    (tmp_path / "docs").mkdir()
    for name in ("conf.py", "site.css"):
        shutil.copy(ROOT / "docs" / name, tmp_path / "docs")
    (tmp_path / "docs" / "index.md").write_text(
        "# Pages\n\n## Tutorials: begin here\n\n| page |\n|---|\n| [The first](first.md#there) |\n\n"
        "## Reference\n\n1. [The numbers](numbers.md)\n",
        encoding="utf-8",
    )
    (tmp_path / "docs" / "first.md").write_text("# One\n\n## There\n\nWords.\n", encoding="utf-8")
    (tmp_path / "docs" / "numbers.md").write_text("- a list\n", encoding="utf-8")
    return tmp_path


def test_the_index_sorts_every_page_into_one_of_four_kinds() -> None:
    kinds = contents((ROOT / f"{INDEX}.md").read_text(encoding="utf-8"))
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")} - {"index.md"}
    assert list(kinds) == KINDS
    counted = Counter(place for places in kinds.values() for place in places)
    assert counted == Counter(pages | {"../README.md", "../CONTRIBUTING.md", "../CHANGELOG.md"})


def test_a_page_stands_where_it_is_linked_as_a_whole() -> None:
    index = "## A: first\n\n| [x](x.md#part) |\n| [y](y.md#part) |\n\n## B\n\n| [all of x](x.md) |\n1. [y](y.md#more)\n"
    assert contents(index) == {"A": {"y.md": "y"}, "B": {"x.md": "all of x"}}


@pytest.mark.slow
def test_the_site_opens_at_its_index_and_a_page_without_a_title_gets_one(two_pages: Path) -> None:
    told = built(two_pages, two_pages / "site")
    assert (told.returncode, told.stderr) == (0, "")
    assert "url=docs/index.html" in (two_pages / "site" / "index.html").read_text(encoding="utf-8")
    index = (two_pages / "site" / "docs" / "index.html").read_text(encoding="utf-8")
    side = re.findall(r'caption-text">([^<]+)<|toctree-l1"><a [^>]*>([^<]+)<', index)
    assert ["".join(one) for one in side] == ["Tutorials", "The first", "Reference", "The numbers"]
    assert "<h1>The numbers<" in (two_pages / "site" / "docs" / "numbers.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("target", ["nowhere.md", "first.md#nowhere", "#nowhere"])
def test_a_link_that_leads_nowhere_is_an_error(two_pages: Path, target: str) -> None:
    (two_pages / "docs" / "numbers.md").write_text(f"# Numbers\n\n[a link]({target})\n", encoding="utf-8")
    told = built(two_pages, two_pages / "site")
    assert told.returncode == 1
    assert "numbers.md:3" in told.stderr and "nowhere" in told.stderr


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole site."""
    out = tmp_path_factory.mktemp("whole") / "site"
    told = built(ROOT, out)
    assert (told.returncode, told.stderr) == (0, "")
    return out


@pytest.mark.long
def test_every_page_is_on_the_site(site: Path) -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    assert [page for page in pages if not (site / page.relative_to(ROOT)).with_suffix(".html").is_file()] == []


@pytest.mark.long
def test_no_page_fetches_anything_from_elsewhere_and_what_it_fetches_is_there(site: Path) -> None:
    pages, styles = list(site.rglob("*.html")), list(site.rglob("*.css"))
    fetched = [(page, one) for page in pages for one in FETCHED.findall(page.read_text(encoding="utf-8"))]
    fetched += [
        (style, "".join(one)) for style in styles for one in IN_STYLE.findall(style.read_text(encoding="utf-8"))
    ]
    assert len(fetched) > 100
    for page, one in fetched:
        place = re.split("[?#]", one)[0]
        assert one.startswith(("data:", "#")) or (page.parent / place).exists(), f"{page}: {one}"


@pytest.mark.long
def test_the_search_works_from_the_disk(site: Path) -> None:
    path = installed()
    with sync_playwright() as made:
        browser = made.chromium.launch(executable_path=path, args=["--no-sandbox"])
        page, asked = browser.new_page(), []
        page.on("request", lambda request: asked.append(request.url))
        page.goto((site / "index.html").as_uri())
        page.fill("input[name=q]", "windage", timeout=120_000)
        page.press("input[name=q]", "Enter")
        page.wait_for_selector("ul.search a[href*='docs/effects.html']", timeout=120_000)
        browser.close()
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
