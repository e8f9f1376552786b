"""The article's figures and studies computed anew: the runs behind Fig. 5, 9, 11-14 and the study of the steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from configs.units import BAR
from model import geometry
from model import layout as at
from model.motor import Motor
from model.operation.runs import spin_up
from model.solvers.published import FIRST_AVERAGED, STEPS, TIME_STEP, March, march
from model.solvers.steady import steady
from model.solvers.transient import Transient

PRESSURE_SHOWN = 2.0e5  # Pa; Fig. 9, 13 and 14
FRICTIONS = (0.0625, 0.0633, 0.0640)  # N m s; Fig. 11
DIAMETER, GROWTH = 24.02517, 1.775  # mm; section 5 and the abstract, for Fig. 12
SWEEP_PA = np.array([1.60, 1.70, 1.80, 1.83, 1.85, 1.95, 2.00]) * BAR  # Table 3, and the average of the abstract
STEP_STUDY = ((5000, 4500), (STEPS, FIRST_AVERAGED), (10_000, FIRST_AVERAGED))  # steps, and the first one averaged
ROUNDS = 4  # of scaling a friction; each leaves a few hundredths of the error before
TIME_STEPS_S = (0.5 * TIME_STEP, TIME_STEP, 2.0 * TIME_STEP, 4.0 * TIME_STEP)


@dataclass(frozen=True)
class Measured:
    """The recorded sweep, Table 3: arrays of shape (n,)."""

    pressure_pa: np.ndarray
    speed_rpm: np.ndarray
    flow_l_min: np.ndarray


@dataclass(frozen=True)
class StepRow:
    """One row of the study of the steps."""

    steps: int
    duration_s: float
    first_averaged: int
    mean_speed_rpm: float


@dataclass(frozen=True)
class PeakRow:
    """What the length of a step makes of the flows' peaks [kg/s]; means and minima do not depend on it."""

    time_step_s: float
    outlet_peak: float
    outlet_lowest: float
    inlet_peak: float
    inlet_mean: float


@dataclass(frozen=True)
class Reproduction:
    """Everything that is compared with the article.

    `angle_rad`, `volume_m3`, shape (n,): Fig. 5: one cylinder over one turn.
    `run`, `transient`, `steady_rpm`: Fig. 9: spin-up at 2.0 bar by the published steps and resolved in angle, and the
        speed that both approach.
    `sweep_pa`, shape (p,): inlet pressures of Fig. 11 and 12 [Pa].
    `friction_rpm`, shape (3, p): Fig. 11: averaged speed of the published algorithm for each of `FRICTIONS`.
    `diameters_mm`, `diameter_rpm`, shape (d,) and (d, p): Fig. 12.
    `cycle`: Fig. 13 and 14: the last cycle of the first cylinder at 2.0 bar, its angle within the lobe.
    `step_rows`: Section 3.
    `peak_rows`: for Fig. 14.
    `measured`: Table 3.
    `plateau_march_rpm`, `plateau_rpm`, `plateau_flow_l_min`, shape (n,): at Table 3's pressures: averaged speed of the
        published algorithm, steady speed, steady flow; empty without it.
    `plateau_friction_rpm`, shape (3, n): the averaged speed for each of `FRICTIONS`.
    `best_friction`: f_overall whose averaged speeds fit Table 3's in least squares, all else at its default [N m s].
    """

    angle_rad: np.ndarray
    volume_m3: np.ndarray
    run: March
    transient: Transient
    steady_rpm: float
    sweep_pa: np.ndarray
    friction_rpm: np.ndarray
    diameters_mm: np.ndarray
    diameter_rpm: np.ndarray
    cycle: March
    step_rows: tuple[StepRow, ...]
    peak_rows: tuple[PeakRow, ...]
    measured: Measured | None
    plateau_march_rpm: np.ndarray
    plateau_rpm: np.ndarray
    plateau_flow_l_min: np.ndarray
    plateau_friction_rpm: np.ndarray
    best_friction: float | None


def reproduce(motor: Motor, measured: Measured | None = None) -> Reproduction:
    """Compute what the article shows. Returns figures and tables as arrays.

    `motor`: the published motor.
    `measured`: Table 3; without it nothing is compared with measurements.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    run = march(motor, PRESSURE_SHOWN)
    diameters = DIAMETER + np.linspace(0.0, GROWTH, 5)
    at_plateaus = measured.pressure_pa if measured is not None else np.empty(0)
    found = steady(motor, [*at_plateaus, PRESSURE_SHOWN])
    rpm = found.speed_rad_s[0] * at.RPM
    plateau_friction = np.array([averaged_speeds(motor, at_plateaus, f_overall=f) for f in FRICTIONS])
    return Reproduction(
        angle_rad=angle,
        volume_m3=geometry.table(motor.vector(), angle)["V_m3"],
        run=run,
        transient=spin_up(motor, PRESSURE_SHOWN, float(run.time_s[-1])),
        steady_rpm=float(rpm[-1]),
        sweep_pa=SWEEP_PA,
        friction_rpm=np.array([averaged_speeds(motor, SWEEP_PA, f_overall=f) for f in FRICTIONS]),
        diameters_mm=diameters,
        diameter_rpm=np.array([averaged_speeds(motor, SWEEP_PA, cylinder_diameter=d) for d in diameters]),
        cycle=last_cycle(run, geometry.lobe_angle(motor.vector())),
        step_rows=study_steps(motor),
        peak_rows=tuple(peaks(motor, dt) for dt in TIME_STEPS_S),
        measured=measured,
        plateau_march_rpm=averaged_speeds(motor, at_plateaus),
        plateau_rpm=rpm[:-1],
        plateau_flow_l_min=found.flow_m3_s[0, :-1] * at.L_MIN,
        plateau_friction_rpm=plateau_friction,
        best_friction=best_friction(motor, measured) if measured is not None else None,
    )


def averaged_speeds(motor: Motor, pressures: np.ndarray, **values: float) -> np.ndarray:
    """Averaged speed of the published algorithm. Returns an array, shape (n,): speeds [rpm].

    `values`: parameters to change, each in its own unit.
    """
    changed = motor.with_values(values)
    return np.array([march(changed, float(P)).mean_speed_rpm for P in pressures])


def best_friction(motor: Motor, measured: Measured) -> float:
    """f_overall whose averaged speeds meet the measured ones in least squares [N m s].

    The speed goes very nearly as 1/f_overall, so each round scales it by the factor that fits the speeds best.

    `motor`: the motor; its f_overall is the start.
    `measured`: the recorded sweep.
    """
    f = motor["f_overall"].value
    for _ in range(ROUNDS):
        speed = averaged_speeds(motor, measured.pressure_pa, f_overall=f)
        f /= float(speed @ measured.speed_rpm / (speed @ speed))
    return f


def last_cycle(run: March, lobe_rad: float) -> March:
    """The last whole cycle of the first cylinder, its angle counted from the start of the lobe.

    `run`: a run with at least two lobes in it.
    `lobe_rad`: angle of a lobe [rad].
    """
    lobe = np.floor(run.angle_rad / lobe_rad)
    last = lobe == lobe[-1] - 1
    return March(
        time_s=run.time_s[last],
        speed_rad_s=run.speed_rad_s[last],
        angle_rad=run.angle_rad[last] % lobe_rad,
        pressure_pa=run.pressure_pa[last],
        mass_kg=run.mass_kg[last],
        inlet_kg_s=run.inlet_kg_s[last],
        outlet_kg_s=run.outlet_kg_s[last],
        mean_speed_rpm=float(run.speed_rad_s[last].mean()) * at.RPM,
    )


def study_steps(motor: Motor) -> tuple[StepRow, ...]:
    """Averaged speeds at 2.0 bar for the numbers of steps that section 3 compares."""
    speed = march(motor, PRESSURE_SHOWN, steps=max(steps for steps, _ in STEP_STUDY)).speed_rad_s * at.RPM
    return tuple(
        StepRow(steps, steps * TIME_STEP, first, float(speed[first:steps].mean())) for steps, first in STEP_STUDY
    )


def peaks(motor: Motor, time_step_s: float) -> PeakRow:
    """Peaks of the flows at 2.0 bar with another step, from the second half of the run.

    `time_step_s`: length of a step [s].
    """
    run = march(motor, PRESSURE_SHOWN, steps=round(STEPS * TIME_STEP / time_step_s), dt=time_step_s)
    half = run.time_s.size // 2
    inlet, outlet = run.inlet_kg_s[half:], run.outlet_kg_s[half:]
    return PeakRow(time_step_s, float(outlet.max()), float(outlet.min()), float(inlet.max()), float(inlet.mean()))
