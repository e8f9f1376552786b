"""`console`: a run watched, started and stopped, in the browser or in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spinbench.cli.options import LOGS, BenchArgument, LogsOption, RateOption


def console(
    bench: BenchArgument,
    terminal: Annotated[
        bool, typer.Option("--terminal", help="The same in this terminal: s stops, a acknowledges, q quits.")
    ] = False,
    logs: LogsOption = LOGS,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page, on this machine; 0: any.")] = 8642,
    rate: RateOption = None,
) -> None:
    """Watch the bench in the browser, and start and stop sweeps there; Ctrl-C ends the console and no sweep."""
    from rig.bench.bench import bench_path, read_bench
    from spinbench.console.desk import Desk

    place = Path(bench_path(bench))
    desk = Desk(place, read_bench(place), logs, () if rate is None else (f"--rate={rate:g}",))
    if terminal:
        from spinbench.console.terminal import watch

        watch(desk)
        return
    from spinbench.console.server import serve

    serve(desk, port, lambda address: print(f"open {address}\nCtrl-C ends the console; a sweep goes on", flush=True))
