"""Recordings that the model itself would give, with an effect in it or none."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibration.unknowns.priors import at_ambient
from model import layout as at
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.effects.laws import readings_of
from model.layout import L_MIN, RPM
from model.motor import Motor, read_motor
from model.solvers.crank_angle import OMEGA
from model.solvers.steady import gas_table
from model.solvers.transient import Supply, rest_state
from rig.recording import Recording, read_recording
from tests.declared import channels

HEAD = f"""format = "recording/1"
motor = "ptm3600"
files = [{{ file = "sweep.csv", kind = "steady" }}]
[ambient]
pressure_bar_abs = 1.01325
pressure_sd_bar = 0.0015
temperature_c = 20.0
relative_humidity = 0.0
{channels(flow_l_min=0.8)}"""


def _motor_of(folder: Path) -> Motor:
    """The motor with what is on its shaft, in the room of a recording."""
    recording = read_recording(folder)
    return at_ambient(read_motor("ptm3600"), recording).with_flywheel(recording.added_inertia_kg_m2)


def sweep(
    folder: Path,
    seed: int,
    chosen: dict[str, dict[str, float]],
    bad_row: int | tuple[int, ...] | None = None,
    slip: float = 0.0,
    off_rpm: float = 30.0,
) -> Recording:
    """A sweep up and down, 1.2 to 2.4 bar, with noise and instrument errors of the declared sizes.

    A row may be misread, or several, by so many rpm. The tachometer may slip, by a share of its reading, from 740 s on.
    """
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.toml").write_text(HEAD, encoding="utf-8")
    (folder / "sweep.csv").write_text(
        "time_s,direction,pressure_bar_abs,flow_l_min,speed_rpm\n0.0,up,1.5,30,170\n", encoding="utf-8"
    )
    motor = _motor_of(folder)
    up = np.arange(1.2, 2.45, 0.1)
    true = np.concatenate([up, up[::-1]]) * 1e5
    time = 40.0 * np.arange(true.size)
    rows = np.tile(motor.vector(), (true.size, 1))
    found = effect_steady.solve(rows, motor.readings.vector(), true, gas_table(motor, true), chosen, time)
    n = true.size
    pressure = readings_of(chosen, "pressure", true, found.state) / 1e5 * (1 + 0.002 * rng.normal())
    pressure = pressure + 0.005 * rng.normal() + 0.0015 * rng.normal(size=n)
    flow = readings_of(chosen, "flow", found.flow, found.state) * L_MIN * (1 + 0.02 * rng.normal())
    flow = flow + 0.5 * rng.normal() + 0.8 * rng.normal(size=n)
    speed = readings_of(chosen, "speed", found.speed, found.state) * RPM * (1 + 0.0005 * rng.normal())
    speed = speed + 0.1 * rng.normal() + 0.4 * rng.normal(size=n)
    speed[time > 740.0] *= 1.0 - slip
    if bad_row is not None:
        speed[np.subtract(bad_row, 1)] += off_rpm
    lines = ["time_s,direction,pressure_bar_abs,flow_l_min,speed_rpm"]
    for i in range(n):
        way = "up" if i < up.size else "down"
        lines.append(
            f"{time[i]},{way},{pressure[i]:.3f},{max(0.0, round(flow[i] * 2) / 2):.1f},{max(0.0, speed[i]):.1f}"
        )
    (folder / "sweep.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_recording(folder)


def every_second_row(folder: Path) -> Recording:
    """A sweep with every second of its rows: each level once, on the way up or down. What is told of it takes less."""
    header, *rows = (folder / "sweep.csv").read_text(encoding="utf-8").splitlines()
    (folder / "sweep.csv").write_text("\n".join([header, *rows[::2]]) + "\n", encoding="utf-8")
    return read_recording(folder)


def add_coast_down(
    folder: Path,
    seed: int,
    chosen: dict[str, dict[str, float]],
    late: float = 0.0,
    level_bar: float = 2.0,
    samples: int = 60,
) -> Recording:
    """A coast-down from a level beside the sweep of a folder: samples at 5 ms, of the effects' own solver.

    The line is empty later than the samples say, by so many seconds.
    """
    rng = np.random.default_rng(seed)
    motor = _motor_of(folder)
    parameters, readings = motor.vector(), motor.readings.vector()
    line = np.array([level_bar * 1e5])
    start = rest_state(motor, float(rng.random()))
    start[OMEGA] = effect_steady.solve(
        parameters[None, :], readings, line, gas_table(motor, line), chosen, np.zeros(1)
    ).speed[0]
    time = 0.005 * np.arange(1, samples + 1)
    supply = [Supply(-0.6, float(line[0]), True), Supply(0.1 + late, float(line[0]), False)]
    run = effect_transient.simulate(
        parameters, readings, supply, np.concatenate([[-0.6], np.arange(-0.5, 0.0, 0.02), [0.0], time]), start, chosen
    )
    shown = np.where(time <= 0.1 + 1e-9, level_bar, motor.si("ambient_pressure") / 1e5)
    return _added(folder, "coast_down.csv", 1100.0, run.reading[-time.size :], time, time <= 0.1 + 1e-9, rng, shown)


def add_spin_up(folder: Path, seed: int, chosen: dict[str, dict[str, float]], late: float = 0.0) -> Recording:
    """A start from rest at 2.0 bar beside the sweep of a folder: 120 samples at 5 ms, of the effects' own solver.

    The air enters later than the samples say, by so many seconds.
    """
    rng = np.random.default_rng(seed)
    motor = _motor_of(folder)
    time = 0.005 * np.arange(1, 121)
    supply = [Supply(-0.6, 2.0e5, False), Supply(0.05 + late, 2.0e5, True)]
    start, begun = rest_state(motor, float(rng.random())), np.append(0.0, time)
    run = effect_transient.simulate(motor.vector(), motor.readings.vector(), supply, begun, start, chosen)
    gauge, _, tachometer = _errors(seed, folder)
    reading = run.reading[1:] * (1 + 0.0005 * tachometer[0]) + 0.1 * tachometer[1] / RPM
    shown = np.where(time > 0.05 + 1e-9, 2.0, 1.01325) * (1 + 0.002 * gauge[0]) + 0.005 * gauge[1]
    return _added(folder, "spin_up.csv", 1200.0, reading, time, time > 0.05 + 1e-9, rng, shown)


def add_held_rotor(folder: Path, seed: int, leak_kg_s: float) -> Recording:
    """Ten readings at 2.0 bar with the rotor held, beside the sweep of a folder."""
    rng = np.random.default_rng(seed + 1000)
    motor = _motor_of(folder)
    gas = gas_table(motor, [2.0e5])[0]
    volume = leak_kg_s * gas[at.GAS_R] * motor.si("inlet_temperature") / 2.0e5 * L_MIN
    gauge, meter, _ = _errors(seed, folder)
    flow = volume * (1 + 0.02 * meter[0]) + 0.5 * meter[1] + 0.8 * rng.normal(size=10)
    pressure = 2.0 * (1 + 0.002 * gauge[0]) + 0.005 * gauge[1] + 0.0015 * rng.normal(size=10)
    rows = zip(pressure, np.round(flow * 2) / 2, strict=True)
    (folder / "held.csv").write_text(
        "time_s,pressure_bar_abs,flow_l_min,speed_rpm,rotor_locked\n"
        + "".join(f"{4 * i:.1f},{p:.3f},{max(0.0, q):.1f},0.0,1\n" for i, (p, q) in enumerate(rows)),
        encoding="utf-8",
    )
    return _listed(folder, '{ file = "held.csv", kind = "steady", start_s = 1300.0 }')


def _errors(seed: int, folder: Path) -> list[np.ndarray]:
    """Scale and offset of gauge, flow meter and tachometer in the sweep of a folder made with a seed, in their sds."""
    rng, n = np.random.default_rng(seed), read_recording(folder).files[0].rows
    drawn = []
    for _ in range(3):  # gauge, flow meter, tachometer: the scale, the offset, and the noise of each row
        drawn.append(rng.normal(size=2))
        rng.normal(size=n)
    return drawn


def _added(
    folder: Path,
    file: str,
    start_s: float,
    reading: np.ndarray,
    time: np.ndarray,
    opened: np.ndarray,
    rng: np.random.Generator,
    line: np.ndarray,
) -> Recording:
    """A folder with one run more, of true speeds [rad/s] and the line's pressures [bar], their noise added."""
    speed = np.maximum(reading * RPM + 0.8 * rng.normal(size=time.size), 0.0)
    pressure = line + 0.003 * rng.normal(size=time.size)
    rows = zip(time, opened.astype(int), pressure, speed, strict=True)
    (folder / file).write_text(
        "time_s,supply_open,pressure_bar_abs,speed_rpm\n"
        + "".join(f"{t:.3f},{o},{p:.3f},{n:.1f}\n" for t, o, p, n in rows),
        encoding="utf-8",
    )
    return _listed(folder, f'{{ file = "{file}", kind = "transient", start_s = {start_s}, noise_scale = 2.0 }}')


def _listed(folder: Path, entry: str) -> Recording:
    """A folder with one file more in its list."""
    text = (folder / "recording.toml").read_text(encoding="utf-8")
    sweep_file = '{ file = "sweep.csv", kind = "steady" }'
    (folder / "recording.toml").write_text(text.replace(sweep_file, f"{sweep_file}, {entry}"), encoding="utf-8")
    return read_recording(folder)


def polled(folder: Path, file: str, every: int, late_s: float, seed: int) -> Recording:
    """A run as a tachometer shows it that is asked: readings are means of `every` rows, and come late."""
    rng = np.random.default_rng(seed)
    header, *lines = (folder / file).read_text(encoding="utf-8").splitlines()
    rows = np.array([line.split(",") for line in lines], dtype=float)
    asked = rows[every - 1 :: every].copy()
    asked[:, 3] = rows[: every * len(asked), 3].reshape(-1, every).mean(axis=1)
    step_s = float(asked[1, 0] - asked[0, 0])
    asked[:, 0] += np.minimum(rng.exponential(late_s, len(asked)), 0.9 * step_s)
    written = [f"{t:.4f},{int(opened)},{bar:.3f},{rpm:.1f}" for t, opened, bar, rpm in asked]
    (folder / file).write_text("\n".join([header, *written]) + "\n", encoding="utf-8")
    text = (folder / "recording.toml").read_text(encoding="utf-8")
    if "window_s" not in text:
        text = text.replace("[channels.speed_rpm]\n", f"[channels.speed_rpm]\nwindow_s = {step_s:.4g}\n")
        (folder / "recording.toml").write_text(text, encoding="utf-8")
    return read_recording(folder)
