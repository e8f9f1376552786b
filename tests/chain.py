"""The whole chain on virtual benches: swept over the wire, verified, replayed, exported, fitted and diagnosed.

    python -m tests.chain benches -o DIR      nothing concealed, on benches of many kinds
    python -m tests.chain concealed -o DIR    the second rig behind the instruments, sealed, with faults in half

Every step is a process of the command, as a user would type it. A case that is done is a line of `DIR/<which>.jsonl`;
a campaign that was interrupted goes on. `--page docs/chain` writes the table there. The tests run a few.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.challenge.second_rig.separable import separable
from calibration.challenge.second_rig.truth import Truth
from rig.bench.bench import FOLDER
from rig.virtual.plant.truth import LineTruth
from tests.chain_page import write_page

ROOT = Path(__file__).resolve().parents[1]
INSTRUMENTS = ROOT / "configs" / "instruments"
TRUE_F_OVERALL = 0.0625  # of configs/motors/ptm3600.toml, which stands behind a bench that conceals nothing
LONGEST_S = 1200.0  # of one command
RUNS, NOTHING_EVERY = 60, 3  # of the concealed: nothing in one of so many
BENCHES = 36
SWEEP = """levels_bar_abs = [1.30, 1.50, 1.70, 1.90, 2.10]
order = "up"
ramp_bar_s = 0.5
window_s = 3.0
dwell_s = 5.0
captures = ["coast-down", "spin-up"]
capture_level_bar_abs = 2.00
"""
AVERAGING = """format = "instrument/1"
family = "ascii"
title = "tachometer that tells a mean"
source = "this campaign"
trust = "simulated"
query = "?\\r"
terminator = "\\r\\n"
pattern = '(?P<speed_rpm>\\d+\\.\\d+)'

[channels.speed_rpm]
unit = "rpm"
lowest = 0.0
highest = 5000.0
noise_sd = 0.2
repeatability_sd = 0.3
scale_sd = 0.0001
resolution = 0.01
"""
# The menu of faults, on the bench's clock; a reply in a hundred, and once a cable that is out for a second.
FAULTS = """faults = [
  { kind = "late", line = "bus", chance = 0.01, by_s = 0.15 },
  { kind = "split", line = "bus", chance = 0.01 },
  { kind = "dropped", line = "net", chance = 0.01 },
  { kind = "doubled", line = "net", chance = 0.01 },
  { kind = "corrupt", device = "gauge", chance = 0.01 },
  { kind = "noise", device = "gauge", chance = 0.01 },
  { kind = "split", line = "usb", chance = 0.01 },
  { kind = "unplug", line = "net", from_s = %(unplug_s).0f, by_s = 1.0 },
]
"""


class StepError(Exception):
    """A step did not end with exit code 0."""


def spinbench(folder: Path, *arguments: str, ends: tuple[int, ...] = (0,)) -> tuple[float, str]:
    """Run a command of the tool.

    Parameters
    ----------
    folder : Path
        To run it in.
    *arguments : str
        Of the command.
    ends : tuple of int
        Exit codes that are no fault.

    Returns
    -------
    float
        How long it took [s].
    str
        What it printed.

    Raises
    ------
    StepError
        With another exit code.
    """
    start = time.monotonic()
    command = [sys.executable, "-m", "spinbench", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    if done.returncode not in ends:
        said = " ".join(done.stderr.split())[-400:]
        raise StepError(f"{arguments[0]} {arguments[1]} ended with {done.returncode}: {said}")
    return time.monotonic() - start, done.stdout


def bench_drawn(index: int) -> dict[str, Any]:
    """One of many benches: a line, a gauge, a tachometer, a clock, and a noise that is as declared or not.

    Parameters
    ----------
    index : int
        Of the bench: the same for the same [-].
    """
    rng = np.random.default_rng([27, index])

    def between(low: float, high: float) -> float:
        return float(math.exp(rng.uniform(math.log(low), math.log(high))))

    gauge_s = (1.0, 0.1, 0.01)[(index + index // 6) % 3]
    tachometer = ("60 teeth", "1 tooth", "mean", "60 teeth", "20 teeth", "mean")[index % 6]
    return {
        "regulator_s": between(0.01, 1.0),
        "volume_l": between(0.1, 5.0),
        "valve_s": between(0.005, 0.1),
        "droop_bar_min_l": between(1e-4, 2e-3),
        "gauge_s": gauge_s,
        "tachometer": tachometer,
        "window_s": between(0.005, 0.5) if tachometer == "mean" else 0.0,
        "declared": (1.0, 1.3, 1.0, 1.0 / 1.3)[(index // 4) % 4],
        "rate": between(1.0, 20.0),
        "supply_told": bool(rng.integers(2)),
        "seed": int(rng.integers(2**31)),
    }


def bench_text(drawn: Mapping[str, Any], folder: Path) -> str:
    """The bench file of a bench that was drawn; its instruments are written beside it.

    Parameters
    ----------
    drawn : mapping
        Of `bench_drawn`.
    folder : Path
        Of the bench file.
    """
    text = (FOLDER / "virtual.toml").read_text(encoding="utf-8")
    head, _, rest = text.partition("[sweep]\n")
    gauge = (INSTRUMENTS / "keller_30x_abs.toml").read_text(encoding="utf-8")
    gauge = gauge.replace("\n[channels.p", f"update_s = {drawn['gauge_s']}\n\n[channels.p", 1)
    (folder / "gauge.toml").write_text(gauge, encoding="utf-8")
    head = head.replace('"keller_30x_abs"', '"gauge"')
    window = drawn["window_s"]
    if window:
        (folder / "mean.toml").write_text(AVERAGING + f"window_s = {window:.4f}\n", encoding="utf-8")
        head = head.replace('"edge_counter_60"', '"mean"')
        head = head.replace('line = "usb"\nperiod_s = 0.1', f'line = "usb"\nperiod_s = {max(window, 0.02):.4f}')
    else:
        head = head.replace("edge_counter_60", f"edge_counter_{drawn['tachometer'].split()[0]}")
    before, _, after = head.partition("[supply]")
    supply = ""
    if drawn["supply_told"]:
        supply = "".join(
            f"{key} = {drawn[name]:.4g}\n{key}_sd = {0.3 * drawn[name]:.4g}\n"
            for key, name in (
                ("regulator_time_s", "regulator_s"),
                ("line_volume_l", "volume_l"),
                ("valve_time_s", "valve_s"),
            )
        )
    head = before + (f"[supply]\n{supply}\n" if supply else "") + "[lines.bus]" + after.partition("[lines.bus]")[2]
    truth = (
        f"regulator_lag_s = {drawn['regulator_s']:.4f}, line_volume_l = {drawn['volume_l']:.4f}, "
        f"valve_time_s = {drawn['valve_s']:.4f}, regulator_droop_bar_min_l = {drawn['droop_bar_min_l']:.6f}, "
        f"tachometer_window_s = {window:.4f}, pitch_error_sd = {0.0 if window else 0.0083}"
    )
    virtual = f"\n[virtual]\nrate = {drawn['rate']:.2f}\nseed = {drawn['seed']}\ntruth = {{ {truth} }}\n"
    assert rest
    return f"{head}[sweep]\n{SWEEP}{virtual}"


def another_noise(recording: Path, factor: float) -> None:
    """Declare another noise than the run's instruments have.

    Parameters
    ----------
    recording : Path
        Its folder.
    factor : float
        On what is declared [-].
    """
    file = recording / "recording.toml"
    lines = file.read_text(encoding="utf-8").splitlines()
    for i, line in enumerate(lines):
        key, _, value = line.partition(" = ")
        if key == "noise_sd":
            lines[i] = f"{key} = {factor * float(value)!r}"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def swept(folder: Path, *sweep: str) -> dict[str, Any]:
    """A sweep over the wire, its run verified, replayed bit for bit and exported to `recording`.

    Parameters
    ----------
    folder : Path
        In which all is done.
    *sweep : str
        Bench and further options of the sweep.

    Returns
    -------
    dict
        How long each step took [s].

    Raises
    ------
    StepError
        When a step fails; the replay does when a sample is another one.
    """
    took = {
        "sweep": spinbench(folder, "sweep", *sweep, "--no-page", "--minutes-running", "0", "--operator", "chain")[0]
    }
    for name, command in (
        ("verify", ("runs", "verify", "last")),
        ("replay", ("replay", "last")),
        ("export", ("runs", "export", "last", "-o", "recording")),
    ):
        took[name] = spinbench(folder, *command)[0]
    return {"seconds": took}


def judged(folder: Path, seed: int) -> dict[str, Any]:
    """The recording diagnosed.

    Parameters
    ----------
    folder : Path
        In which `recording` lies.
    seed : int
        Of the diagnosis.

    Returns
    -------
    dict
        Its verdict, its p-value, what it names, f_overall after it, and how long it took [s].
    """
    seconds, _ = spinbench(
        folder, "diagnose", "recording", "--json", "diagnosis.json", "--seed", str(seed), ends=(0, 5)
    )
    said = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    friction = said["f_overall_after"] or {}
    return {
        "verdict": said["verdict"],
        "p_value": said["mismatch"]["p_value"],
        "named": [one["id"] for one in said["effects"]],
        "alternatives": said["alternatives"],
        "f_overall": {key: friction.get(key) for key in ("mean", "sd", "q05", "q95")},
        "diagnose_s": seconds,
    }


def a_bench(folder: Path, index: int, fastest: float = math.inf) -> dict[str, Any]:
    """One bench that conceals nothing, from bytes to fit and verdict.

    Parameters
    ----------
    folder : Path
        New; everything is done in it.
    index : int
        Of the bench [-].
    fastest : float
        Its clock is slowed down to this, where other work keeps the machine busy [-].
    """
    drawn = bench_drawn(index)
    drawn["rate"] = min(drawn["rate"], fastest)
    (folder / "bench.toml").write_text(bench_text(drawn, folder), encoding="utf-8")
    done: dict[str, Any] = {"bench": drawn, "true": TRUE_F_OVERALL}
    done |= swept(folder, "bench.toml")
    another_noise(folder / "recording", drawn["declared"])
    fit = ("fit", "recording", "-o", "fit", "--seed", "1", "--effective-samples", "300")
    done["fit_s"], _ = spinbench(folder, *fit, ends=(0, 5))
    posterior = json.loads((folder / "fit" / "posterior.json").read_text(encoding="utf-8"))
    figure = posterior["parameters"]["f_overall"]
    done["fit"] = {key: figure[key] for key in ("mean", "sd", "q05", "q95")}
    done["fit_p_value"] = posterior["fit_quality"]["p_value"]
    return done | judged(folder, index)


def a_concealed(folder: Path, index: int) -> dict[str, Any]:
    """One bench that conceals something, from bytes to what is revealed.

    Parameters
    ----------
    folder : Path
        New; everything is done in it.
    index : int
        Of the case [-].
    """
    faults = index % 2 == 1
    text = (FOLDER / "virtual.toml").read_text(encoding="utf-8")
    text = text.replace("rate = 20.0 ", "rate = 10.0 ").replace("seed = 1", f"seed = {1000 + index}")
    if faults:
        moment = float(np.random.default_rng([27, index, 1]).uniform(60.0, 200.0))
        text = text.rstrip("\n") + "\n" + FAULTS % {"unplug_s": moment}
    (folder / "bench.toml").write_text(text, encoding="utf-8")
    nothing = ("--only", "none") if index % NOTHING_EVERY == 0 else ()
    key = folder.parent / f"{folder.name}.key"
    sealed = ("--conceal", "seal", "--key", str(key), *nothing)
    done: dict[str, Any] = {"faults": faults} | swept(folder, "bench.toml", *sealed)
    done |= judged(folder, index)
    spinbench(folder, "reveal", "seal", "--key", str(key), "--diagnosis", "diagnosis.json", "--json", "revealed.json")
    told = json.loads((folder / "revealed.json").read_text(encoding="utf-8"))
    return done | {"revealed": told["score"], "sizes": told["truth"]["sizes"], "line": told["line"]}


def could_be_told(folder: Path) -> dict[str, Any]:
    """Whether a case's recording can tell what was concealed from everything else, by the second rig's signatures.

    Parameters
    ----------
    folder : Path
        Of a case that is done.
    """
    told = json.loads((folder / "revealed.json").read_text(encoding="utf-8"))
    line, area = told["line"], LineTruth().valve_area_mm2
    supply = {
        "regulator_time_s": line["regulator_lag_s"],
        "droop_bar_min_l": line["regulator_droop_bar_min_l"],
        "valve_time_s": line["valve_time_s"],
        "valve_area_mm2": area,
        "vent_area_mm2": area,
        "line_volume_l": line["line_volume_l"],
    }
    return separable(Truth(**told["truth"] | {"supply": supply}), folder / "recording")


def campaign(which: str, out: Path, cases: int, first: int = 0) -> list[dict[str, Any]]:
    """Do what is left of a campaign.

    Parameters
    ----------
    which : str
        ``benches`` or ``concealed``.
    out : Path
        Folder of its cases.
    cases : int
        How many there are [-].
    first : int
        Those before it are left out [-].

    Returns
    -------
    list of dict
        All that are done.
    """
    out.mkdir(parents=True, exist_ok=True)
    kept = out / f"{which}.jsonl"
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    done = [json.loads(line) for line in lines]
    for index in sorted(set(range(first, cases)) - {one["case"] for one in done}):
        folder = out / f"{which}-{index:03d}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        found: dict[str, Any] = {"case": index}
        try:
            found |= {"benches": a_bench, "concealed": a_concealed}[which](folder, index)
        except (StepError, subprocess.TimeoutExpired) as problem:
            found["failed"] = str(problem)
        with kept.open("a", encoding="utf-8") as file:
            file.write(json.dumps(found) + "\n")
        done.append(found)
        print(f"{which} {len(done)}/{cases}: {found.get('failed') or found['verdict']}", flush=True)
    done.sort(key=lambda one: one["case"])
    if which == "concealed":
        for one in done:
            if "failed" not in one:
                one["separable"] = could_be_told(out / f"{which}-{one['case']:03d}")
    return done


def main() -> int:
    """Run a campaign; the exit status is 1 when a step failed in any case."""
    parser = argparse.ArgumentParser(description="The whole chain on virtual benches, a case after the other")
    parser.add_argument("which", choices=("benches", "concealed"))
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the cases; a campaign goes on in it")
    parser.add_argument("--cases", type=int, help=f"how many ({BENCHES} benches, {RUNS} concealed)")
    parser.add_argument("--first", type=int, default=0, help="leave out the cases before this one")
    parser.add_argument("--page", type=Path, help="write the table and the cases in this folder")
    options = parser.parse_args()
    count = options.cases or {"benches": BENCHES, "concealed": RUNS}[options.which]
    done = campaign(options.which, options.out, count, options.first)
    print(write_page(options.which, done, options.page))
    return int(any("failed" in one for one in done))


if __name__ == "__main__":
    sys.exit(main())
