"""A virtual bench that conceals something: the process that serves it, and `reveal`, which opens its seal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spinbench.cli.options import JsonOption, SealKeyOption
from spinbench.cli.show import check_places, remark, takes_output
from spinbench.extras import need


def reveal(
    seal: Annotated[Path, typer.Argument(metavar="SEAL", help="The folder that --conceal named.")],
    diagnosis: Annotated[
        Path | None,
        typer.Option("--diagnosis", metavar="FILE", help="What `diagnose` wrote, or its folder: it is scored."),
    ] = None,
    key: SealKeyOption = None,
    json_file: JsonOption = None,
) -> None:
    """Open the seal of a concealed bench: what was concealed, and what a diagnosis of it is worth."""
    need("cryptography")
    from calibration.challenge.concealed import revealing
    from rig.recording import files

    check_places(None, json_file)
    found = None if diagnosis is None else revealing.read_diagnosis(diagnosis)
    contents = revealing.reveal(seal, key)
    if found is not None:
        remark(*revealing.refuse_of_another(contents, found))
    scored = None if found is None else revealing.score(contents, found)
    data = files.json_bytes({**contents, "format": "reveal/1", "score": scored})
    if takes_output(data, json_file):
        return
    for words in (*revealing.in_words(contents), *([] if scored is None else revealing.score_in_words(scored))):
        print(words)


def server_of(conceal: Path | None, seed: int | None, only: str, key: Path | None) -> tuple[str, ...] | None:
    """The process that serves a bench which conceals something; None for one that does not."""
    if conceal is None:
        if seed is not None or only or key is not None:
            raise typer.BadParameter("--conceal-seed, --only and --key belong to --conceal SEAL")
        return None
    need("cryptography")
    from calibration.challenge.concealed.bench import command

    return command(conceal.resolve(), None if key is None else key.resolve(), seed, only)
