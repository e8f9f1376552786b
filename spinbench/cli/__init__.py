"""The command line: a file a group of commands, each command a call or two into the rooms below.

What is slow to import is imported inside the commands, so that `spinbench --help` answers at once.

    model, fit, diagnose, init, sweep, sheet, bench, concealing, replay, runs, challenge, many     the commands
    options     arguments and options that several of them share
    show        tables, JSON, files and remarks
    errors      exit codes, and mistakes told in words
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from spinbench.cli import (
    bench,
    challenge,
    concealing,
    diagnose,
    fit,
    init,
    many,
    model,
    replay,
    runs,
    sheet,
    sweep,
)
from spinbench.cli.errors import exit_code, in_words
from spinbench.cli.show import remark, suit_the_terminal


class _Command(TyperCommand):
    """A command whose help shows no `<bool>` beside a switch, and no boxes: they cut names on a narrow terminal."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _with_plain_types(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse an option that is given twice, where one of the two would be left out in silence."""
        given = self.make_parser(ctx).parse_args(args=list(args))[2]
        single = [one for one in given if not one.multiple and one.param_type_name == "option"]
        for i, one in enumerate(single):
            if one in single[:i]:
                ctx.fail(f"{'/'.join(one.opts + one.secondary_opts)} is given twice; give it once")
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        super(TyperCommand, self).format_help(ctx, formatter)


class _Group(TyperGroup):
    """A group of commands, likewise."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _with_plain_types(super().get_params(ctx))

    def format_help(self, ctx: Any, formatter: Any) -> None:
        super(TyperGroup, self).format_help(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Commands with what they do, whole."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, one.get_short_help_str(limit=1000)) for name, one in self.commands.items()])


KINDS = {"str": "text", "int": "whole number", "float": "number"}  # words of a help for types of the language


def _with_plain_types(parameters: list[Any]) -> list[Any]:
    """Parameters whose help has no type of a switch, and that of any other, or of one of several values, in words."""
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
        elif hasattr(parameter, "type_descriptor") and not parameter.type_descriptor.is_choice:
            parameter.display_type = partial(_kind, parameter.display_type)
    return parameters


def _kind(of_language: Callable[..., str], ctx: Any) -> str:
    told = of_language(ctx).strip("<>").removeprefix("list[").removesuffix("]").removesuffix(" range").lower()
    return f"<{KINDS.get(told, told)}>"


app = typer.Typer(
    cls=_Group,
    help="Bench tool for a pneumatic radial piston motor: calibrates its dynamic model and says how sure it is.",
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
runs_app = typer.Typer(
    cls=_Group, help="The runs that were logged: list, show, verify, repair, export, import.", no_args_is_help=True
)
challenge_app = typer.Typer(
    cls=_Group,
    help="Sealed blind campaigns: make recordings, run the diagnosis, score it, show the ledger.",
    no_args_is_help=True,
)
many_app = typer.Typer(
    cls=_Group,
    help="Many recordings at once, a fleet or a year of runs: one table, as CSV and Parquet.",
    no_args_is_help=True,
)

# In the order in which the help shows them.
for command in (
    model.simulate,
    model.sensitivity,
    fit.fit,
    diagnose.diagnose,
    diagnose.compare,
    many.trend,
    model.reproduce,
    init.init,
    sweep.sweep,
    sweep.capture,
    bench.console,
    sheet.sheet,
    bench.doctor,
    bench.virtual,
    concealing.reveal,
    replay.replay,
):
    app.command(cls=_Command)(command)

app.add_typer(runs_app, name="runs")
runs_app.command("list", cls=_Command)(runs.list_all)
runs_app.command("show", cls=_Command)(runs.show)
runs_app.command("verify", cls=_Command)(runs.verify)
runs_app.command("repair", cls=_Command)(runs.repair)
runs_app.command("export", cls=_Command)(runs.export)
runs_app.command("import", cls=_Command)(runs.import_data)

app.add_typer(challenge_app, name="challenge")
challenge_app.command("make", cls=_Command)(challenge.make)
challenge_app.command("run", cls=_Command)(challenge.run)
challenge_app.command("score", cls=_Command)(challenge.score)
challenge_app.command("pool", cls=_Command)(challenge.pool)
challenge_app.command("ledger", cls=_Command)(challenge.ledger)

app.add_typer(many_app, name="many")
many_app.command("diagnose", cls=_Command)(many.diagnose)
many_app.command("fit", cls=_Command)(many.fit)


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"spinbench {version('spinbench')}{_commit()}")
        raise typer.Exit


def _commit() -> str:
    """Which commit this is, and whether files were changed since; nothing of an installed program."""
    from pathlib import Path
    from subprocess import SubprocessError, run

    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        command = ["git", "-C", str(root), "describe", "--always", "--exclude=*", "--dirty"]
        told = run(command, capture_output=True, text=True, timeout=30, check=True).stdout.strip()
    except (OSError, SubprocessError):
        return ""
    return f" (commit {told})"


def _look_at_the_project() -> None:
    """Read the project's file, where there is one, before a command begins: what is wrong in it is told at once."""
    from pathlib import Path

    here = Path.cwd()
    if any((folder / "spinbench.toml").is_file() for folder in (here, *here.parents)):
        from configs import project_of

        project_of(here)


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Options of the bare command, which tells what can be done next; --version has done its work before."""
    _look_at_the_project()
    if context.invoked_subcommand is None:
        from spinbench.cli.options import LOGS
        from spinbench.next_steps import shown

        print(shown(LOGS))


def main() -> None:
    """Run the command line; a mistake of the user's is told in a line each on standard error."""
    suit_the_terminal()
    try:
        app()
    except Exception as error:
        code = exit_code(error)
        if code is None:
            raise
        remark(*in_words(error))
        sys.exit(code)
