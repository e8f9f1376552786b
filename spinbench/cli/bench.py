"""`doctor` examines a bench, `console` watches one, `virtual` serves one that is not there."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench.cli import options
from spinbench.cli.concealing import server_of
from spinbench.cli.errors import UNUSABLE_INPUT
from spinbench.cli.show import on_terminal
from spinbench.progress import waiting

if TYPE_CHECKING:
    from spinbench.console.live import Live


def doctor(
    bench: options.BenchArgument,
    scan: Annotated[
        bool, typer.Option("--scan", help="Try Modbus addresses 1 to 16 where a device is silent.")
    ] = False,
) -> None:
    """Examine a bench: ports, identities, rates, and known culprits with their cure; exit code 2 on a fault."""
    with waiting(f"reading {bench}"):
        from rig.bench.bench import bench_path, read_bench
        from rig.doctor import Level, examine, table
        from rig.run.place import place_of

        place = bench_path(bench)
        read = read_bench(place)
    with place_of(read, place, 1.0, waiting=waiting) as there, waiting(f"examining {read.name}"):
        findings = examine(read, there.ports, there.clock, scan_units=range(1, 17) if scan else ())
    on_terminal(table(findings))
    if any(finding.level is Level.FAULT for finding in findings):
        raise typer.Exit(UNUSABLE_INPUT)


def virtual(
    bench: options.BenchArgument,
    state: Annotated[
        Path, typer.Option("--state", metavar="DIR", help="Where ports.json and the links to the ptys go.")
    ],
    rate: options.RateOption = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of noise, errors and faults; the bench file's if left out.")
    ] = None,
    conceal: options.SealOption = None,
    conceal_seed: options.ConcealSeedOption = None,
    only: options.OnlyOption = "",
    key: options.SealKeyOption = None,
) -> None:
    """Serve a virtual bench until Ctrl-C, for another program; a sweep on a virtual bench starts its own."""
    from rig.bench.bench import bench_path, read_bench
    from rig.virtual.serve import serve

    server_of(conceal, conceal_seed, only, key)
    read = read_bench(bench_path(bench))
    state.mkdir(parents=True, exist_ok=True)

    def ready() -> None:
        print(f"serving {bench} until Ctrl-C; {state / 'ports.json'} tells the ports", file=sys.stderr, flush=True)

    plant_of = None
    if conceal is not None:
        from calibration.challenge.concealed.bench import concealed_plant

        plant_of = concealed_plant(conceal, key, conceal_seed, only)
    serve(read, state, rate, None, seed, plant_of=plant_of, ready=ready)


def console(
    bench: options.BenchArgument,
    terminal: Annotated[
        bool, typer.Option("--terminal", help="The same in this terminal: s stops, a acknowledges, q quits.")
    ] = False,
    logs: options.LogsOption = options.LOGS,
    port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="Port of the page, on this machine; 8642, or the next that is free, if left out."
        ),
    ] = None,
    listen: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Address of this machine at which others may open the page; 0.0.0.0 is all of its addresses. "
            "A browser then needs the token to watch, too.",
        ),
    ] = "127.0.0.1",
    rate: options.RateOption = None,
    mqtt: Annotated[
        str, typer.Option(metavar="HOST[:PORT]", help="Publish the newest readings and the state there, read only.")
    ] = "",
    opcua: Annotated[
        str, typer.Option(metavar="HOST[:PORT]", help="The same over OPC UA, served at this address of this machine.")
    ] = "",
) -> None:
    """Watch the bench in the browser, and start and stop sweeps there; Ctrl-C ends the console and no sweep."""
    from rig.bench.bench import bench_path, read_bench
    from spinbench.console.desk import Desk

    place = Path(bench_path(bench))
    read = read_bench(place)
    published: list[Live] = []
    with contextlib.ExitStack() as ends:
        if mqtt:
            from spinbench.console.mqtt import Mqtt

            published.append(Mqtt(mqtt, read.name))
            ends.callback(published[-1].close)
        if opcua:
            from spinbench.console.opcua import OpcUa

            published.append(OpcUa(opcua, read.name))
            ends.callback(published[-1].close)
        desk = Desk(place, read, logs, () if rate is None else (f"--rate={rate:g}",), published)
        if terminal:
            from spinbench.console.terminal import watch

            watch(desk)
            return
        from spinbench.console.server import serve

        told = "Ctrl-C ends the console; a run goes on"
        serve(desk, port, lambda address: print(f"open {address}\n{told}", flush=True), listen)
