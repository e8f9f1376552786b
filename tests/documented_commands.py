"""The commands of README and docs, run as they stand there: ``python -m tests.documented_commands [PAGE ...]``.

Each ``sh`` block is read line by line. What a page shows of a command's output, in a comment ``# -> ...`` beside or
below it or in a ``text`` block after it, must be in its output: ``...`` or ``…`` stands for anything, ``about 0.064``
for a figure within one unit of its last digit. ``# exit code 4`` is the exit status, 0 where none is said. What cannot
run in a minute is marked in the page, before the block, for all its commands or for those numbered::

    <!-- run: long 2 4-5: why -->
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = (page.relative_to(ROOT) for folder in ("docs", "docs/tutorials") for page in (ROOT / folder).glob("*.md"))
PAGES = ("README.md", "CONTRIBUTING.md", *sorted(page.as_posix() for page in DOCS))
PUBLIC_DATA = Path(os.environ.get("SPINBENCH_RECORDINGS", ROOT.parent / "shared" / "recordings"))
KINDS = {
    "long": "the campaign runs it",
    "hours": "the campaign runs it when asked to",
    "background": "started, stopped at the end of the page",
    "data": "the campaign runs it where the public data are",
    "yours": "never run",  # needs recordings that only a reader has
    "hardware": "never run",
    "person": "never run",
    "network": "never run",
}
# No mark is needed for what the README begins with.
SELF_MARKED = {"make demo": ("long", "sweeps and fits"), "make test": ("hours", "the suite, with these tests")}
MARK = re.compile(r"<!-- run: ([a-z ]+?)((?: \d+(?:-\d+)?)*): (.+) -->")
FENCE = re.compile(r"^(\s*)```(\w*)$")
STATUS = re.compile(r"\bexit code (\d+)")
ELISION = re.compile(r"\.\.\.|…")
NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
BOX = re.compile("[\u2500-\u259f\\s]+")
NOT_FRESH = (".git", ".venv", "out", "build", "dist", ".*_cache", ".hypothesis", ".coverage*")
KERNELS = ("__pycache__",)


@dataclass
class Command:
    """A line of a page's ``sh`` block, with what the page says of it."""

    page: str
    line: int
    text: str
    kinds: frozenset[str] = frozenset()
    reason: str = ""
    shown: list[str] = field(default_factory=list)
    status: int = 0

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


def _marked(comments: Iterable[str]) -> Callable[[int], tuple[str, str] | None]:
    marks = []
    for comment in comments:
        if (mark := MARK.fullmatch(comment)) is None:
            raise ValueError(f"{comment}: expected {MARK.pattern}")
        spans = [(int(first), int(last or first)) for first, last in re.findall(r"(\d+)(?:-(\d+))?", mark[2])]
        marks.append((mark[1], spans, mark[3]))

    def of(number: int) -> tuple[str, str] | None:
        for kinds, spans, reason in marks:
            if not spans or any(first <= number <= last for first, last in spans):
                return kinds, reason
        return None

    return of


def _blocks(lines: list[str]) -> Iterator[tuple[str, list[str], int, list[str]]]:
    """Language, marks, number of the first line (from 1) and lines of each fenced block."""
    marks: list[str] = []
    at = 0
    while at < len(lines):
        fence = FENCE.match(lines[at])
        if fence is None:
            line = lines[at].strip()
            marks = [*marks, line] if line.startswith("<!-- run:") else marks if not line else []
            at += 1
            continue
        end = lines.index(fence[1] + "```", at + 1)
        yield fence[2], marks, at + 2, [line.strip() for line in lines[at + 1 : end]]
        marks = []
        at = end + 1


def commands_of(page: str, text: str) -> list[Command]:
    """The commands of a page in order.

    Parameters
    ----------
    page : str
        Its name.
    text : str
        Its Markdown.
    """
    found: list[Command] = []
    ends = -1
    for language, marks, start, lines in _blocks(text.splitlines()):
        if language == "text" and found and not "".join(text.splitlines()[ends : start - 2]).strip():
            found[-1].shown += [line for line in lines if line]
        if language != "sh":
            continue
        mark_of, number = _marked(marks), 0
        for at, line in enumerate(lines, start):
            words, _, comment = f" {line}".partition(" #")
            if words.strip():
                number += 1
                kinds, reason = mark_of(number) or SELF_MARKED.get(words.strip(), ("", ""))
                found.append(Command(page, at, words.strip(), frozenset(kinds.split()), reason))
            if comment.strip().startswith("->"):
                found[-1].shown.append(comment.partition("->")[2])
            if status := STATUS.search(comment):
                found[-1].status = int(status[1])
        ends = start + len(lines)
    return found


def commands() -> list[Command]:
    """The commands of all pages."""
    return [found for page in PAGES for found in commands_of(page, (ROOT / page).read_text(encoding="utf-8"))]


def not_in(output: str, shown: str) -> str | None:
    """The first piece of what a page shows that the output does not have in its place, or None.

    Parameters
    ----------
    output, shown : str
        What a command printed, and what the page says of it.
    """
    flat, at = BOX.sub(" ", output), 0
    for piece in filter(None, (BOX.sub(" ", part).strip() for part in ELISION.split(shown))):
        words = re.split(rf"\babout ({NUMBER})", piece)
        figures = words[1::2]
        pattern = f"({NUMBER})".join(re.escape(word) for word in words[::2])
        units = [10.0 ** -len(figure.partition("e")[0].partition(".")[2]) for figure in figures]
        for match in re.compile(pattern).finditer(flat, at):
            near = zip(match.groups(), figures, units, strict=True)
            if all(abs(float(got) - float(figure)) <= 1.000001 * unit for got, figure, unit in near):
                at = match.end()
                break
        else:
            return piece
    return None


def fresh_copy(to: Path, *, kernels: bool) -> None:
    """Copy the tree as it is checked out, with an environment whose commands run the copy's code.

    Parameters
    ----------
    to : Path
        The copy; must not be there.
    kernels : bool
        Take compiled kernels along.
    """
    leave = shutil.ignore_patterns(*NOT_FRESH, *(() if kernels else KERNELS))

    def ignored(folder: str, names: list[str]) -> set[str]:
        runs = [name for name in names if name != "published_sweep"] if Path(folder) == ROOT / "logs" else []
        return {*leave(folder, names), *runs}

    shutil.copytree(ROOT, to, ignore=ignored)
    environment = to / ".venv"
    environment.mkdir()
    for name in ("bin", "lib", "pyvenv.cfg"):
        (environment / name).symlink_to(Path(sys.prefix) / name)
    (environment / ".installed").touch()  # or make would install


def _put_public_data(to: Path) -> None:
    to.mkdir()
    for file in PUBLIC_DATA.rglob("*"):
        if file.is_file():
            shutil.copyfile(file, to / file.name)


def _environment(copy: Path) -> dict[str, str]:
    return os.environ | {
        "PATH": f"{copy / '.venv' / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(copy),
        "XDG_STATE_HOME": str(copy.with_name(f"{copy.name}-state")),
        "COLUMNS": "250",
    }


class Shell:
    """Runs commands in a copy; what runs in the background is stopped at the end.

    Parameters
    ----------
    copy : Path
        The copy of the tree.
    longest_s : float
        A command may take this long.
    """

    def __init__(self, copy: Path, longest_s: float) -> None:
        self.copy, self.longest_s = copy, longest_s
        self.background: list[tuple[Command, subprocess.Popen[str], Path]] = []

    def _start(self, command: Command) -> tuple[subprocess.Popen[str], Path]:
        told = self.copy.with_name(f"{self.copy.name}-{command.line}.txt")
        with told.open("w", encoding="utf-8") as out:
            process = subprocess.Popen(
                ["bash", "-c", command.text],
                cwd=self.copy,
                env=_environment(self.copy),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
        return process, told

    def run(self, command: Command) -> str | None:
        """Run a command, or start it if it is one for the background, and say what is not as the page says.

        Parameters
        ----------
        command : Command
            What the page has.
        """
        process, told = self._start(command)
        until = time.monotonic() + self.longest_s
        if "background" in command.kinds:
            self.background.append((command, process, told))
            while process.poll() is None and time.monotonic() < until:
                if not _wrong(command, told, command.status):
                    return None
                time.sleep(0.1)
            return _wrong(command, told, command.status) or "it ended by itself"
        try:
            process.wait(self.longest_s)
        except subprocess.TimeoutExpired:
            self._stop(process, signal.SIGKILL)
            return f"not done after {self.longest_s:.0f} s"
        return _wrong(command, told, process.returncode)

    @staticmethod
    def _stop(process: subprocess.Popen[str], how: signal.Signals) -> None:
        if process.poll() is None:
            os.killpg(process.pid, how)
        process.wait(30.0)

    def close(self) -> list[str]:
        """End what runs in the background, the last first, as Ctrl-C does; what is wrong with how it ended."""
        wrong = []
        for command, process, told in reversed(self.background):
            try:
                self._stop(process, signal.SIGINT)
                found = _wrong(command, told, process.returncode)
            except subprocess.TimeoutExpired:
                self._stop(process, signal.SIGKILL)
                found = "Ctrl-C does not end it"
            wrong += [f"{command}: {found}"] if found else []
        return wrong


def _wrong(command: Command, told: Path, status: int) -> str | None:
    output = told.read_text(encoding="utf-8", errors="replace")
    if status != command.status:
        return f"exit code {status}, not {command.status}: ...{output[-1500:]}"
    if "Traceback (most recent call last)" in output:
        return f"a traceback: ...{output[-1500:]}"
    for shown in command.shown:
        if (piece := not_in(output, shown)) is not None:
            return f"does not say '{piece}': {output[-6000:]}"
    return None


def run_page(
    wanted: list[Command], copy: Path, longest_s: float, tell: Callable[[str], None] = lambda text: None
) -> list[str]:
    """Run commands of one page in order; what is not as the page says.

    Parameters
    ----------
    wanted : list of Command
        Those that are to run.
    copy : Path
        A fresh copy of the tree.
    longest_s : float
        A command may take this long.
    tell : callable, optional
        Hears a line about each command.
    """
    shell, wrong = Shell(copy, longest_s), []
    try:
        for command in wanted:
            since = time.monotonic()
            found = shell.run(command)
            tell(f"{time.monotonic() - since:7.1f} s  {'WRONG' if found else 'as said'}  {command}")
            wrong += [f"{command}: {found}"] if found else []
    finally:
        wrong += shell.close()
    return wrong


def main() -> int:
    """Run the commands of the pages; 1 when one is not as its page says."""
    parser = argparse.ArgumentParser(prog="python -m tests.documented_commands", description=__doc__)
    parser.add_argument("pages", nargs="*", metavar="PAGE", default=PAGES, help="README.md, docs/fit.md, ...")
    parser.add_argument("--hours", action="store_true", help="also what takes hours")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "docs-commands", help="gets the copies")
    options = parser.parse_args()
    if unknown := set(options.pages) - set(PAGES):
        parser.error(f"no such page: {', '.join(unknown)}; there are {', '.join(PAGES)}")
    signal.signal(signal.SIGINT, signal.default_int_handler)  # or what is started in the background ignores Ctrl-C too
    runs = {"long", "background", *(["data"] if PUBLIC_DATA.is_dir() else []), *(["hours"] if options.hours else [])}
    wrong: list[str] = []
    left: list[Command] = []
    for page in options.pages:
        found = [command for command in commands() if command.page == page]
        wanted = [command for command in found if command.kinds <= runs]
        left += [command for command in found if not command.kinds <= runs]
        if wanted:
            copy = options.out.resolve() / page.replace("/", "-").removesuffix(".md")
            shutil.rmtree(copy, ignore_errors=True)
            fresh_copy(copy, kernels=False)
            if any("data" in command.kinds for command in wanted):
                _put_public_data(copy / "public")
            wrong += run_page(wanted, copy, 6 * 3600.0, lambda text: print(text, flush=True))
    for command in left:
        print(f"  not run  {command} ({', '.join(sorted(command.kinds))}: {command.reason})")
    for text in wrong:
        print(f"\n{text}")
    print(f"{len(wrong)} of the commands are not as their pages say; {len(left)} were not run")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
