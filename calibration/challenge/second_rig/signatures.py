"""What each effect and each nuisance does to the readings of one recording, by the second rig and in units of noise.

The declared figures alone enter: noise, resolution, priors. A gauge's reading stands for the pressure, so a change is
counted at equal reading, and the gauge's noise moves speed and flow of a row together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.challenge.second_rig import bench
from calibration.challenge.second_rig.bench import Rig
from calibration.challenge.second_rig.concealed import TRANSIENT_ONLY, USUAL
from calibration.challenge.second_rig.draws import ERRORS, WIDTHS
from calibration.challenge.second_rig.instruments import misread
from calibration.challenge.second_rig.machine.slots import BAR
from calibration.challenge.second_rig.runs_seen import RunAsked, RunsSeen, noise_of, noise_sd, run_of, told_of
from calibration.challenge.second_rig.sheets import COLUMN
from calibration.challenge.second_rig.sizes import OTHER_FORMS, in_form
from calibration.challenge.second_rig.small_torques import SmallTorques
from calibration.challenge.second_rig.truth import Truth
from rig.recording import Recording, RecordingFile

SLOPE_PA = 2000.0  # over which slopes with the line's pressure are taken
FLAT = float(np.log(0.4 / 0.01) / np.sqrt(12.0))  # sd of ln f_overall, log-uniform from 0.01 to 0.4
ANGLE = 0.1  # rad; at which a supply changes, the same for all
LEVEL_PA = 4000.0  # rows nearer than this are of one level
ROLLER, INERTIA = 2, 5  # places among the nuisances
LINE = 6 + len(ERRORS)  # where those of the line begin, and then those of each run

# Probes: effects of a small size in their usual form, with the shapes that it can have. One-sided ones have no negative
# size.
PROBES: tuple[tuple[str, tuple[dict[str, float], ...], bool], ...] = (
    ("coulomb_friction", ({"torque_nm": 0.05},), True),
    ("stribeck_friction", tuple({"torque_nm": 0.08, "speed_rad_s": w} for w in (4.0, 8.0, 14.0)), True),
    ("windage", ({"drag_nm_s2": 5e-5},), True),
    ("load_friction", ({"roller_factor": 0.008},), True),
    ("friction_warm_up", tuple({"share_cold": 0.05, "time_s": t} for t in (120.0, 300.0, 800.0)), False),
    ("once_per_rev_torque", ({"sine_nm": 0.1, "cosine_nm": 0.0}, {"sine_nm": 0.0, "cosine_nm": 0.1}), False),
    ("inlet_throttling", ({"loss_pa_s2_m6": 6e8},), True),
    ("exhaust_back_pressure", ({"rise_pa_s2_m6": 2e8},), True),
    ("leakage", ({"conductance_kg_s_pa2": 5e-15},), True),
    ("wall_heat_exchange", ({"extra_share": 4.0},), True),
    ("pressure_gauge_offset", ({"offset_pa": 500.0},), False),
    ("pressure_gauge_scale", ({"scale": 0.005},), False),
    ("flow_offset", ({"offset_m3_s": 1e-5},), False),
    ("flow_scale", ({"scale": 0.02},), False),
    ("flow_density_correction", ({"share": 0.2},), True),
    ("speed_scale", ({"scale": 0.01},), False),
    ("speed_lag", ({"time_s": 0.01},), True),
    ("inertia", ({"share": 0.1},), False),
)
# What some other forms have besides the size of the usual one.
BESIDES: dict[str, tuple[dict[str, float], ...]] = {
    "smoothed": tuple({"width_rad_s": width} for width in (1.0, 2.0, 4.0)),
    "power": tuple({"exponent": exponent} for exponent in (1.7, 2.2, 2.5)),
    "exponent": tuple({"exponent": exponent} for exponent in (0.4, 0.6)),
}


@dataclass(frozen=True)
class Asked:
    """What a recording's files ask of the rig.

    `steady`: rows, the file's noise scale, and whether it is the first sweep.
    `noise`: declared noise and resolution of each channel [SI].
    `errors`: declared sds of the instruments' errors, by the names that a truth gives them.
    """

    steady: list[tuple[bench.Plateaus, float, bool]]
    zeros: list[tuple[int, float]]
    runs: list[RunAsked]
    told: dict[str, Any]
    noise: dict[str, tuple[float, float]]
    errors: dict[str, float]


@dataclass(frozen=True)
class Probed:
    """What a small effect does to the readings.

    `change`, shape (m, shapes): change of the readings for each shape of the form [-].
    """

    id: str
    form: str
    change: np.ndarray
    one_sided: bool


def asked_of(recording: Recording, truth: Truth) -> Asked:
    """The rows and runs of a recording, at the pressures that its gauge read.

    `truth`: the case: its gauge's errors are taken off, its line and its instruments are those of the runs.
    """
    base = bench.without(truth.rig(recording.added_inertia_kg_m2), ())
    steady, zeros, runs, told = [], [], [], told_of(recording, truth)
    for file in recording.files:
        if file.kind == "zero":
            zeros.append((file.rows, file.noise_scale))
            continue
        if file.kind == "transient":
            runs.append(run_of(file, truth, told, base, ANGLE))
            continue
        lines = (file.columns["pressure_bar_abs"].values - truth.errors.get("pressure_offset_bar", 0.0)) * BAR
        lines = lines / (1.0 + truth.errors.get("pressure_scale", 0.0))
        clock = file.start_s + file.columns["time_s"].values
        plateaus = bench.Plateaus(_levels(lines), clock, _ways(file), "rotor_locked" in file.columns)
        steady.append((plateaus, file.noise_scale, file.file == "sweep.csv"))
    return Asked(steady, zeros, runs, told, noise_of(recording), _errors_of(recording))


def _errors_of(recording: Recording) -> dict[str, float]:
    found = dict.fromkeys(ERRORS, 0.0)
    for name in found:
        channel = recording.channels[COLUMN[name.partition("_")[0]]]
        found[name] = channel.scale_sd if name.endswith("_scale") else channel.bias_sd
    return found


def _levels(lines: np.ndarray) -> np.ndarray:
    """Each pressure replaced by the mean of its level: rows of a level are marched once [Pa]."""
    order = np.argsort(lines)
    groups = np.split(order, np.flatnonzero(np.diff(lines[order]) > LEVEL_PA) + 1)
    found = lines.copy()
    for group in groups:
        found[group] = np.mean(lines[group])
    return found


def _ways(file: RecordingFile) -> np.ndarray:
    if file.direction is None:
        return np.zeros(file.rows)
    return np.array([{"up": 1.0, "down": -1.0}.get(str(word), 0.0) for word in file.direction])


class Whitened:
    """The readings of a recording as one vector of unit noise, for any rig near a base."""

    def __init__(self, asked: Asked, base: Rig) -> None:
        self.asked = asked
        self.base = base
        self._slopes = [self._row_slopes(rows) for rows, _, _ in asked.steady]
        self.runs = RunsSeen(asked.runs, asked.told, asked.noise, base)

    def _row_slopes(self, rows: bench.Plateaus) -> np.ndarray:
        here = bench.plateaus(self.base, rows)
        more = bench.plateaus(self.base, replace(rows, lines=rows.lines + SLOPE_PA))
        return np.column_stack([more.speed - here.speed, more.flow - here.flow]) / SLOPE_PA

    def readings(
        self,
        rig: Rig,
        line: np.ndarray | None = None,
        plateaus: Sequence[bench.Steady] = (),
    ) -> np.ndarray:
        """Whitened readings of a rig, shape (m,) [-].

        `line`, shape (k,), or None: by how many declared sds the nuisances of the line and of the runs are off; nothing
            when left out [-].
        `plateaus`: by file of steady rows, what gives its plateaus; marched when left out.
        """
        parts = []
        steady = plateaus or [bench.marched] * len(self.asked.steady)
        for (rows, scale, first), slopes, given in zip(self.asked.steady, self._slopes, steady, strict=True):
            found = bench.plateaus(rig, rows, given)
            p, q, n = found.pressure, found.flow, found.speed
            if first:
                p, q, n = (misread(rig.effects, c, x) for c, x in (("pressure", p), ("flow", q), ("speed", n)))
            parts.append(self._white(p, q, n, slopes, scale, rows.locked))
        for count, scale in self.asked.zeros:
            found = bench.at_rest(rig, count)
            parts += [getattr(found, one) / noise_sd(self.asked.noise[one], scale) for one in ("pressure", "flow")]
        return np.concatenate([*parts, *self.runs.readings(rig, line)])

    def nuisances(self, rig: Rig | None = None, z: np.ndarray | None = None) -> np.ndarray:
        """Change per declared sd of each nuisance, shape (m, k) [-].

        Figures of the motor come first, then the instruments' errors, then those of the line and of each run, see
        `RunsSeen`.

        `rig`: the rig; None for the base.
        `z`, shape (k,), or None: by how many declared sds its nuisances are off already; nothing for None [-].
        """
        rig, steps = rig or self.base, self.steps
        z = np.zeros(steps.size) if z is None else z
        y = self.moved(rig, z)
        ones = np.eye(steps.size)
        return np.column_stack(
            [(self.moved(rig, z + step * one) - y) / step for step, one in zip(steps, ones, strict=True)]
        )

    @property
    def mean_line(self) -> float:
        """Mean pressure of the steady rows' line, or of the runs' where there are none [Pa]."""
        lines = [rows.lines for rows, _, _ in self.asked.steady] or [
            np.array([one.run.line for one in self.asked.runs])
        ]
        return float(np.mean(np.concatenate(lines)))

    @property
    def steps(self) -> np.ndarray:
        """Over which slopes with the nuisances are taken, in declared sds, shape (k,)."""
        width = WIDTHS["declared"]
        motor = (
            np.log(1.02) / FLAT,
            0.3,
            np.log(1.5) / width["roller_factor"],
            450.0 / width["ambient_pa"],
            3.0 / width["inlet_k"],
            np.log(1.05) / width["inertia"],
        )
        return np.array([*motor, *np.ones(len(ERRORS)), *self.runs.steps])

    def moved(self, rig: Rig, z: np.ndarray) -> np.ndarray:
        """Whitened readings of a rig whose nuisances are off by so many declared sds, shape (m,) [-].

        `z`, shape (k,): in the order of `nuisances` [-].
        """
        width, own = WIDTHS["declared"], dict(rig.nuisances)
        f_overall, lap, roller_factor, ambient, inlet, inertia = z[:6]
        changed = own | {
            "f_overall": own["f_overall"] * np.exp(FLAT * f_overall),
            "lap": own["lap"] + width["lap"] * lap,
            "roller_factor": own["roller_factor"] * np.exp(width["roller_factor"] * roller_factor),
            "ambient_pa": own["ambient_pa"] + width["ambient_pa"] * ambient,
            "inlet_k": own["inlet_k"] + width["inlet_k"] * inlet,
            "inertia": own["inertia"] * np.exp(width["inertia"] * inertia),
        }
        errors = {
            name: rig.errors.get(name, 0.0) + sd * one
            for (name, sd), one in zip(self.asked.errors.items(), z[6:LINE], strict=True)
        }
        return self.readings(replace(rig, nuisances=changed, errors=dict(rig.errors) | errors), z[LINE:])

    def wrapped(self, rig: Rig, z: np.ndarray) -> np.ndarray:
        """The same nuisances with each run's angle counted from the nearest pulse, shape (k,) [-].

        Where an effect follows the shaft, a pulse on is another angle: then nothing is taken off.

        `z`, shape (k,): in the order of `nuisances` [-].
        """
        if any(one.id == "once_per_rev_torque" for one in rig.effects):
            return z
        found = z.copy()
        angles = found[LINE:][self.runs.angles]  # a view
        angles -= np.sqrt(12.0) * np.round(angles / np.sqrt(12.0))
        return found

    def grown(self, z: np.ndarray) -> np.ndarray:
        """By what a slope with each nuisance has grown at so many declared sds: a factor does as its value, shape (k,).

        `z`, shape (k,): in the order of `nuisances` [-].
        """
        width, found = WIDTHS["declared"], np.ones(z.size)
        found[0], found[2], found[5] = np.exp(np.array([FLAT, width["roller_factor"], width["inertia"]]) * z[[0, 2, 5]])
        return found

    def effects(self) -> list[Probed]:
        """What a small effect changes, in every form that the rig knows of it; small torques to first order."""
        y, found = self.readings(self.base), []
        near = [bench.marched if rows.locked else SmallTorques(self.base, rows) for rows, _, _ in self.asked.steady]
        for name, shapes, one_sided in PROBES:
            if name in TRANSIENT_ONLY and not self.asked.runs:
                continue
            others = (form for family in OTHER_FORMS.get(name, ()) for form in family)
            for form in dict.fromkeys((USUAL[name], *others)):
                ones = (in_form(name, form, like | besides) for besides in BESIDES.get(form, ({},)) for like in shapes)
                columns = [self.readings(replace(self.base, effects=(one,)), plateaus=near) - y for one in ones]
                found.append(Probed(name, form, np.column_stack(columns), one_sided))
        return found

    def rows(self) -> np.ndarray:
        """Change by one misread reading, for each row and channel of the first sweep, shape (m, rows) [-]."""
        before, size = 0, self.readings(self.base).size
        for (rows, scale, first), slopes in zip(self.asked.steady, self._slopes, strict=True):
            n, nothing = rows.lines.size, np.zeros(rows.lines.size)
            if first:
                found = np.zeros((size, 3 * n))
                for column in range(3 * n):
                    p, q, one = (np.eye(n)[column % n] if column // n == i else nothing for i in range(3))
                    found[before : before + 2 * n, column] = self._white(p, q, one, slopes, scale, False)
                return found
            before += n if rows.locked else 2 * n
        return np.empty((size, 0))

    def _white(
        self, p: np.ndarray, q: np.ndarray, n: np.ndarray, slopes: np.ndarray, scale: float, locked: bool
    ) -> np.ndarray:
        """Speed and flow of steady rows at equal gauge reading in units of noise: Cholesky of each row's covariance."""
        sp, sq, sn = (noise_sd(self.asked.noise[channel], scale) for channel in ("pressure", "flow", "speed"))
        if locked:
            return (q - slopes[:, 1] * p) / np.hypot(sq, slopes[:, 1] * sp)
        a = np.hypot(sn, slopes[:, 0] * sp)
        b = slopes[:, 0] * slopes[:, 1] * sp**2 / a
        c = np.sqrt(sq**2 + (slopes[:, 1] * sp) ** 2 - b**2)
        speed = (n - slopes[:, 0] * p) / a
        return np.concatenate([speed, (q - slopes[:, 1] * p - b * speed) / c])
