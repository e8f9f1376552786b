"""How a command ends that does not finish: exit codes, and mistakes of the user's told in words."""

from __future__ import annotations

import builtins
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from spinbench.cli.show import remark

Command = Callable[..., None]

UNUSABLE_INPUT, NOT_CONVERGED, RUN_FAILED, MODEL_DOES_NOT_FIT, CHANGED = 2, 3, 4, 5, 6
NO_FOLDER = "a file, where a folder is needed; name another place"
INTERRUPTED = 130  # as a shell has it for what Ctrl-C ends
# Errors that are told in words instead of with a traceback, by their class's full name (which needs no import), and
# the exit code of each. A class that is not listed counts as its nearest listed base; anything else is our own mistake.
EXIT_CODES = {
    "builtins.OSError": UNUSABLE_INPUT,
    "calibration.challenge.campaign.layout.ChallengeError": UNUSABLE_INPUT,
    "calibration.fit.fit.NotConvergedError": NOT_CONVERGED,
    "calibration.fit.peak.NoPeakError": UNUSABLE_INPUT,
    "calibration.fit.store.ChainError": UNUSABLE_INPUT,
    "calibration.systems.radial_piston.batch.effects.EffectsError": UNUSABLE_INPUT,
    "configs.ConfigError": UNUSABLE_INPUT,
    "model.operation.performance.OperatingPointError": UNUSABLE_INPUT,
    "rig.acquisition.recorder.RecorderError": RUN_FAILED,
    "rig.bench.instrument.IdentityError": UNUSABLE_INPUT,
    "rig.bench.instrument.InstrumentError": UNUSABLE_INPUT,
    "rig.interlock.SafetyError": UNUSABLE_INPUT,
    "rig.lines.port.LineError": UNUSABLE_INPUT,
    "rig.recording.contents.RecordingError": UNUSABLE_INPUT,
    "rig.runlog.folder.RunError": UNUSABLE_INPUT,
    "rig.sweep.ambient.AmbientError": UNUSABLE_INPUT,
    "rig.plateaus.plan.SweepError": UNUSABLE_INPUT,
    "rig.virtual.launch.VirtualBenchError": UNUSABLE_INPUT,
    "model.operation.performance.NotSettledError": NOT_CONVERGED,
    "spinbench.console.access.ConsoleError": UNUSABLE_INPUT,
    "spinbench.extras.MissingPackageError": UNUSABLE_INPUT,
}


def exit_code(error: Exception) -> int | None:
    """The exit code of an error that is told in words; None for one that deserves its traceback."""
    names = (f"{base.__module__}.{base.__qualname__}" for base in type(error).__mro__)
    return next((EXIT_CODES[name] for name in names if name in EXIT_CODES), None)


def in_words(error: Exception) -> list[str]:
    """What an error says to the person, a line each, its notes last."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        why = NO_FOLDER if isinstance(error, FileExistsError | NotADirectoryError) else error.strerror
        text = f"{error.filename}: {why}" if error.filename else why
    return [*text.splitlines(), *getattr(error, "__notes__", ())]


def without_class(error: str) -> str:
    """An error without its class, unless it is one of Python's that a file or a system call does not raise."""
    kind, _, words = error.partition(": ")
    is_class = kind.endswith("Error") and kind.isidentifier()
    return words if is_class and issubclass(getattr(builtins, kind, OSError), OSError) else error


def kept_when_interrupted(kept: Callable[[Path | None], str]) -> Callable[[Command], Command]:
    """Ctrl-C in a command ends it with exit code 130, in words: what is kept of it, by its folder of results."""

    def around(command: Command) -> Command:
        @functools.wraps(command)
        def told(**given: Any) -> None:
            try:
                command(**given)
            except KeyboardInterrupt:
                remark(f"interrupted; {kept(given['out'])}")
                raise typer.Exit(INTERRUPTED) from None

        return told

    return around
