"""A person at a terminal: how far the run is, what happened, and questions answered in a line."""

from __future__ import annotations

import sys

from rich.markup import escape

from rig.progress import DONE, TASK, Bar, Elapsed, bar_of


class Terminal:
    """A bar on standard error, with what is said above it; a context manager."""

    def __init__(self, title: str) -> None:
        self.bar = bar_of(TASK, Bar, DONE, Elapsed)
        self.console = self.bar.console
        self.title = title
        self._task = self.bar.add_task(escape(title), total=1.0)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar.live.is_started:  # one that is stopped without having begun leaves an empty line
            self.bar.stop()

    def say(self, text: str, warning: bool = False) -> None:
        """Tell the person something."""
        self.console.print(f"[yellow]{escape(text)}[/yellow]" if warning else escape(text), highlight=False)

    def advance(self, done: int, total: int, text: str) -> None:
        """How far it is."""
        if not self.bar.live.is_started:
            self.bar.start()
        self.bar.update(self._task, description=escape(f"{self.title}: {text}"), completed=done, total=max(total, 1))

    def ask(self, prompt: str) -> str:
        """Put a question, with the bar out of the way. Raises EOFError when the terminal was closed."""
        self.bar.stop()
        return ask(prompt)


def ask(prompt: str) -> str:
    """Put a question on standard error and return the line that was typed.

    Raises EOFError when the terminal was closed.
    """
    print(f"{prompt.rstrip().removesuffix(':')}: ", end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline(4096)
    if not line:
        raise EOFError("the terminal was closed")
    return line.rstrip("\n")


def somebody_is_there() -> bool:
    """Whether standard input is a terminal."""
    return sys.stdin.isatty()


def why_failed(error: BaseException) -> str:
    """Why a run failed. Where its output is closed, as by ``| head``, rich ends the program on a BrokenPipeError."""
    if isinstance(error, BrokenPipeError) or (
        isinstance(error, SystemExit) and isinstance(error.__context__, BrokenPipeError)
    ):
        return "its output was closed"
    return f"{type(error).__name__}: {error}"
