"""Recordings of other rigs whose truth is known, by integrators of their own; noise is coloured and off its figures.

Nuisances are drawn as the recording declares them: an instrument's offset and scale, the noise level (log-normal 0.3),
a volume. `torque` and `pressure` laws are plain functions, not those of model/effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

from rig.recording import Ambient, Channel, Column, Recording, RecordingFile

RPM = 30.0 / np.pi
ATM = 101_325.0
Law = Callable[[np.ndarray], np.ndarray]


def nothing(speed: np.ndarray) -> np.ndarray:
    """No torque at all."""
    return np.zeros_like(speed)


def coloured(rng: np.random.Generator, n: int, sd: float, rho: float) -> np.ndarray:
    """Noise whose neighbours are correlated."""
    noise = rng.standard_normal(n)
    noise[1:] = lfilter([np.sqrt(1.0 - rho * rho)], [1.0, -rho], noise[1:], zi=[rho * noise[0]])[0]
    return sd * noise


def recording(
    motor: dict[str, Any], figures: dict[str, tuple[float, float, float, float]], files: list[dict[str, Any]]
) -> Recording:
    """A recording that was never on disk."""
    made = []
    for i, columns in enumerate(files, start=1):
        kind = columns.pop("kind")
        known = {k: Column(np.asarray(v, dtype=float), np.zeros(len(v), dtype=np.int8)) for k, v in columns.items()}
        made.append(RecordingFile(f"part_{i}.csv", kind, 0.0, 1.0, len(next(iter(columns.values()))), known))
    channels = {name: Channel(name, *four) for name, four in figures.items()}
    return Recording(
        Path("simulated"), motor, Ambient(pressure_bar_abs=1.01325, temperature_c=20.0), channels, tuple(made)
    )


def rotor(rng: np.random.Generator, torque: Law = nothing, rho: float = 0.3) -> Recording:
    """Two coast-downs of a rotor of 0.02 kg m2 and 0.003 N m s, marched by the midpoint rule."""
    J, f, step, per = 0.02, 0.003, 0.002, 100
    sd = 0.5 * np.exp(0.3 * rng.standard_normal())
    offset, scale = 0.1 * rng.standard_normal(), 1.0 + 0.0005 * rng.standard_normal()
    files = []
    for first in (60.0, 35.0):
        omega, angle, angles = first, 0.0, [0.0]
        for _ in range(80):
            for _ in range(per):
                half = omega - 0.5 * step * (f * omega + float(torque(np.array(omega)))) / J
                new = max(omega - step * (f * half + float(torque(np.array(half)))) / J, 0.0)
                angle, omega = angle + 0.5 * step * (omega + new), new
            angles.append(angle)
        mean = np.concatenate([[first], np.diff(angles) / (step * per)]) * RPM
        moving = mean > 15.0
        read = mean[moving] * scale + offset + coloured(rng, int(moving.sum()), float(sd), rho)
        files.append({"kind": "transient", "time_s": step * per * np.arange(read.size), "speed_rpm": np.round(read, 1)})
    motor = {"kind": "free_rotor", "inertia_kg_m2": J}
    return recording(motor, {"speed_rpm": (0.5, 0.1, 0.0005, 0.1)}, files)


def axis(rng: np.random.Generator, force: Law = nothing, rho: float = 0.5) -> Recording:
    """A slide of 20 kg and 100 N s/m driven to and fro; its noise is coloured, and changes little over a block."""
    time = np.arange(0.0, 25.0, 0.01)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    w, size = np.array([1.1, 2.3, 4.1]), np.array([0.12, 0.05, 0.02])
    v = (size * np.sin(np.outer(time, w) + phase)).sum(axis=1)
    a = (size * w * np.cos(np.outer(time, w) + phase)).sum(axis=1)
    true = 20.0 * a + 100.0 * v + np.sign(v) * force(np.abs(v))
    sd = np.exp(0.3 * rng.standard_normal())
    read = true * (1.0 + 0.01 * rng.standard_normal()) + rng.standard_normal()
    read += coloured(rng, time.size, 0.8 * float(sd), rho**0.2)
    speed = v + 2e-4 * rng.standard_normal(time.size)
    files = [{"kind": "transient", "time_s": time, "force_n": read, "velocity_m_s": speed}]
    figures = {"force_n": (0.8, 1.0, 0.01, 0.0), "velocity_m_s": (2e-4, 0.0, 0.001, 0.0)}
    return recording({"kind": "driven_axis", "mass_kg": 20.0}, figures, files)


def turned_axis(rng: np.random.Generator, inertia: float, flywheel: float) -> Recording:
    """An axis of 0.02 N m s turned to and fro, its rotor said to have 0.005 kg m2. `inertia`, `flywheel`: [kg m2]."""
    time, phase = np.arange(0.0, 25.0, 0.01), rng.uniform(0.0, 2.0 * np.pi, 3)
    w, size = np.array([3.3, 6.9, 12.3]), np.array([12.0, 5.0, 2.0])
    v = (size * np.sin(np.outer(time, w) + phase)).sum(axis=1)
    a = (size * w * np.cos(np.outer(time, w) + phase)).sum(axis=1)
    torque = (inertia + flywheel) * a + 0.02 * v + coloured(rng, time.size, 0.01, 0.8)
    speed = (v + 0.02 * rng.standard_normal(time.size)) * RPM
    files = [{"kind": "transient", "time_s": time, "torque_nm": torque, "speed_rpm": speed}]
    figures = {"torque_nm": (0.01, 0.005, 0.005, 0.0), "speed_rpm": (0.2, 0.0, 0.0005, 0.0)}
    made = recording({"kind": "driven_axis", "inertia_kg_m2": 0.005}, figures, files)
    return replace(made, folder=Path(f"with {flywheel:g}"), added_inertia_kg_m2=flywheel)


def cylinder(rng: np.random.Generator, dry: float = 0.0, per_pascal: float = 0.0) -> Recording:
    """A piston of 5 cm2 moved to and fro at four pressures; its seal rubs by a constant and by the pressure."""
    files = []
    for gauge in (1e5, 3e5, 5e5, 7e5):
        time = np.arange(0.0, 40.0, 0.1)
        v = 0.012 * np.clip(3.0 * np.sin(2.0 * np.pi * time / 8.0 + rng.uniform(0.0, 6.0)), -1.0, 1.0)
        pressure = gauge * (1.0 + 0.005 * np.sin(time / 7.0))
        force = 300.0 * v + 5e-4 * pressure + np.sign(v) * (dry + per_pascal * pressure)
        force += rng.standard_normal() + coloured(rng, time.size, 0.7, 0.6)
        speed = v + 3e-4 * rng.standard_normal(time.size)
        files.append(
            {
                "kind": "transient",
                "time_s": time,
                "force_n": force,
                "velocity_m_s": speed,
                "pressure_bar_gauge": pressure / 1e5,
            }
        )
    figures = {
        "force_n": (0.7, 1.0, 0.01, 0.0),
        "velocity_m_s": (3e-4, 0.0, 0.001, 0.0),
        "pressure_bar_gauge": (0.002, 0.01, 0.005, 0.001),
    }
    return recording({"kind": "driven_axis", "mass_kg": 0.5}, figures, files)


def machine(
    rng: np.random.Generator,
    torque: Law = nothing,
    leak: float = 0.0,
    loss: float = 0.0,
    without: str = "",
) -> Recording:
    """Thirty steady rows of a machine of 1e-4 m3 and 0.004 N m s: a leak in kg/(s Pa2), a loss in Pa s2/m6 at 2 bar."""
    P, speed = (
        grid.ravel() for grid in np.meshgrid(np.array([2.0, 3.0, 4.0, 5.0, 6.0]) * 1e5, np.linspace(20, 200, 6))
    )
    V = 1e-4 * 1.05 ** rng.standard_normal() / (2.0 * np.pi)
    RT = 287.05 * 293.15
    density = P / RT
    behind = P.copy()
    for _ in range(200):  # the loss and the flow that makes it, by relaxation
        flow = V * speed * behind / P + leak * (P**2 - ATM**2) / density
        behind = 0.8 * behind + 0.2 * (P - loss * density / 2.38 * flow**2)
    drive = 0.004 * speed + torque(speed) - V * (behind - ATM)
    sd = np.exp(0.3 * rng.standard_normal(3))
    e = rng.standard_normal
    columns = {
        "kind": "steady",
        "pressure_bar_abs": P / 1e5 * (1.0 + 0.002 * e()) + 0.005 * e() + 0.002 * sd[0] * e(P.size),
        "flow_l_min": flow * 6e4 * (1.0 + 0.02 * e()) + e() + sd[1] * e(P.size),
        "speed_rpm": speed * RPM,
        "torque_nm": drive * (1.0 + 0.005 * e()) + 0.02 * e() + 0.02 * sd[2] * e(P.size),
    }
    columns.pop(without, None)
    figures = {
        "pressure_bar_abs": (0.002, 0.005, 0.002, 0.0),
        "flow_l_min": (1.0, 1.0, 0.02, 0.0),
        "speed_rpm": (0.5, 0.1, 0.0005, 0.1),
        "torque_nm": (0.02, 0.02, 0.005, 0.0),
    }
    figures = {name: four for name, four in figures.items() if name != without}
    return recording({"kind": "displacement_machine", "displacement_m3_per_rev": 1e-4}, figures, [columns])


def with_force(one: Recording, factor: float) -> Recording:
    """An axis whose force was recorded with another factor, such as the other sign."""
    files = []
    for file in one.files:
        force = file.columns["force_n"]
        columns = {**file.columns, "force_n": Column(factor * force.values, force.censor)}
        files.append(replace(file, columns=columns))
    return replace(one, files=tuple(files))
