"""What the report of a fit shows, as numbers: predictions with their bands, trade-offs, densities. Nothing is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import gaussian_kde

from calibration.data.measurement import MISSING, OBSERVED, PRESSURE_LIMITS_BAR, Rows
from calibration.fit.fit import Fit
from calibration.fit.posterior import Posterior, SuspectRow, thinned
from calibration.fit.whole import LEVELS
from calibration.unknowns.priors import Unknown, column_of, values_of
from configs.units import BAR
from model import layout as at
from model.solvers import steady
from rig.recording.columns import OF_CHANNEL

GRID_POINTS = 41
NOISE_NODES = ndtri((np.arange(15) + 0.5) / 15.0)  # of a standard normal, equally probable: bands without raggedness
TARGET = "f_overall"
BINS, KEPT = 48, 2000  # points of a grid each way; draws that a density is made of
MARGIN = 0.15  # of the samples' range, that a density is drawn beyond it
SHARES = (0.90, 0.68)  # of the draws, that a region of a density holds
WEAK, MOST = 0.25, 4  # a correlation below it is not worth a word; how many are told


@dataclass(frozen=True)
class Expected:
    """What the fit expects an instrument to read: a new reading, with the noise and rounding of all instruments.

    `pressure_bar`, shape (n,): what the pressure gauge reads [bar].
    `mean`, `sd`, shape (n,): in the channel's unit.
    `quantiles`, shape (5, n): at `LEVELS`, in the channel's unit.
    `slope_per_bar`, shape (n,): how the mean grows with the pressure [unit/bar].
    """

    pressure_bar: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    quantiles: np.ndarray
    slope_per_bar: np.ndarray


@dataclass(frozen=True)
class Channel:
    """One channel's readings beside what the fit expects.

    `reading`, `error`, shape (n_rows,): readings, and one standard deviation of their declared noise and rounding, in
        the unit.
    `state`, shape (n_rows,): OBSERVED, MISSING, BELOW or ABOVE.
    `at_rows`, `curve`: at the rows' pressures, and over the range of pressures.
    """

    name: str
    unit: str
    reading: np.ndarray
    error: np.ndarray
    state: np.ndarray
    at_rows: Expected
    curve: Expected


@dataclass(frozen=True)
class Suspect:
    """A reading that is probably bad, beside what the fit expects it to be; figures in the column's unit.

    `reading`, `expected`, `sd`: as read, and the mean and sd of what the fit expects, in the channel's unit.
    """

    row: SuspectRow
    index: int
    channel: str
    reading: float
    expected: float
    sd: float


def channels(found: Fit) -> list[Channel]:
    """Speed and flow, as far as the fit used them, measured and expected."""
    rows = found.measured.steady
    at_rows = expected(found, rows.pressure, rows.is_gauge, rows.noise_scale, times(found))
    room_bar = found.motor.si("ambient_pressure") / BAR if rows.is_gauge[0] else 0.0
    grid = _grid(rows.pressure, room_bar)
    middle = np.full(grid.shape, np.median(times(found)))
    over = expected(found, grid, np.full(grid.shape, rows.is_gauge[0]), np.ones(grid.shape), middle)
    return [
        Channel(
            name,
            OF_CHANNEL[name].unit,
            getattr(rows, name),
            reading_sd(found, name, rows),
            getattr(rows, f"{name}_state"),
            at_rows[name],
            over[name],
        )
        for name in ("speed", "flow")
        if name in found.measured.channels and np.any(getattr(rows, f"{name}_state") != MISSING)
    ]


def times(found: Fit) -> np.ndarray:
    """Time of each steady row on the recording's clock, where the fit has effects that may ask for it [s]."""
    held = found.likelihood.effects
    return held.time if held is not None else np.zeros(len(found.measured.steady))


def expected(
    found: Fit, pressure_bar: np.ndarray, is_gauge: np.ndarray, noise_scale: np.ndarray, time: np.ndarray
) -> dict[str, Expected]:
    """What speed and flow would read where the pressure gauge reads this, over draws from the posterior.

    `pressure_bar`, shape (n,): what the gauge reads [bar].
    `is_gauge`, shape (n,): the pressure is counted from the ambient's.
    `noise_scale`, shape (n,): the file's random noise, times the channel's [-].
    `time`, shape (n,): on the recording's clock, for effects that change with it [s].
    By channel: speed and flow.
    """
    motor, z = found.motor, thinned(found.posterior.chain.flat())
    parameters, errors = found.likelihood.split(z)
    nominal = pressure_bar * BAR + np.where(is_gauge, motor.si("ambient_pressure"), 0.0)
    gas, chosen = steady.gas_table(motor, nominal), found.likelihood.chosen(z)
    out = found.likelihood.states(parameters, errors, chosen, pressure_bar, is_gauge, gas, time)
    solved = np.all(out[..., steady.STATUS] != steady.NOT_CONVERGED, axis=1)
    out, errors = out[solved], errors[solved]
    var_p = _variance(found, "pressure", errors, noise_scale) / (1.0 + errors[:, 0, 1:2]) ** 2
    result = {}
    for i, name, column, slope_column, to_unit in (
        (1, "flow", steady.VOLUME_FLOW, steady.FLOW_SLOPE, at.L_MIN),
        (2, "speed", steady.SPEED_OUT, steady.SPEED_SLOPE, at.RPM),
    ):
        gain = to_unit * (1.0 + errors[:, i, 1:2])
        slope = out[..., slope_column] * gain * BAR
        variance = _variance(found, name, errors, noise_scale) + var_p * slope**2
        result[name] = _mixture(pressure_bar, out[..., column] * gain + errors[:, i, 0:1], variance, slope)
    return result


def reading_sd(found: Fit, channel: str, rows: Rows) -> np.ndarray:
    """Declared noise and rounding of a channel, one sd a row, shape (n_rows,), in the channel's unit."""
    column = column_of(found.recording, channel)
    if column is None:
        return np.zeros(len(rows))
    figures = found.recording.channels[column]
    return np.sqrt((figures.noise_sd * rows.noise_scale) ** 2 + figures.resolution**2 / 12.0)


def suspects(found: Fit) -> list[Suspect]:
    """The readings that are probably bad, beside what the fit expects them to be."""
    if not found.posterior.suspect_rows:
        return []
    rows = found.measured.steady
    beside = expected(found, rows.pressure, rows.is_gauge, rows.noise_scale, times(found))
    places = {(file, int(row)): i for i, (file, row) in enumerate(zip(rows.file, rows.row, strict=True))}
    result = []
    for suspect in found.posterior.suspect_rows:
        index, channel = places[suspect.file, suspect.row], suspect.channel.partition("_")[0]
        if channel == "pressure":
            mean, sd = _pressure_from_the_rest(rows, beside, index)
        else:
            mean, sd = float(beside[channel].mean[index]), float(beside[channel].sd[index])
        reading = float(getattr(rows, channel)[index])
        result.append(Suspect(suspect, index, channel, reading, mean, sd))
    return result


def trade_offs(posterior: Posterior) -> list[tuple[Unknown, float]]:
    """The other unknowns with their correlation with f_overall, strongest first [-]."""
    names = [estimate.unknown.name for estimate in posterior.estimates]
    r = np.corrcoef(posterior.values, rowvar=False)[names.index(TARGET)]
    others = [
        (estimate.unknown, float(value))
        for estimate, value in zip(posterior.estimates, r, strict=True)
        if estimate.unknown.name != TARGET
    ]
    return sorted(others, key=lambda pair: -abs(pair[1]))


def strongest(pairs: Sequence[tuple[Unknown, float]]) -> list[tuple[Unknown, float]]:
    """Of pairs of unknown and correlation those that are worth a word and a picture, strongest first."""
    return [(unknown, r) for unknown, r in pairs if abs(r) >= WEAK][:MOST]


def samples(posterior: Posterior, *names: str) -> np.ndarray:
    """Samples of unknowns, each in its unit, shape (n_names, n_samples): all of the chain, where it holds them all."""
    unknowns = [estimate.unknown for estimate in posterior.estimates]
    places = [[unknown.name for unknown in unknowns].index(name) for name in names]
    sampled = posterior.chain.flat()
    if max(places) >= sampled.shape[1]:  # integrated out: drawn beside a part of the chain alone
        return posterior.values[:, places].T
    return values_of([unknowns[place] for place in places], sampled[:, places]).T


def prior_density(unknown: Unknown, values: np.ndarray) -> np.ndarray:
    """The prior's density at values within its support, shape as ``values`` [1/unit]."""
    z = np.array([unknown.z(float(value)) for value in values])
    if unknown.kind == "loguniform":
        inside = (values >= unknown.a) & (values <= unknown.b)
        return np.where(inside, 1.0 / (values * np.log(unknown.b / unknown.a)), 0.0)
    slope = 1.0 / unknown.b if unknown.kind == "normal" else 1.0 / (values * np.log(unknown.b))
    return np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) * slope


def density_regions(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[float]]:
    """A smoothed density of samples in the plane, and the heights that enclose SHARES of them.

    `x`, `y`, shape (n,): samples, each in its own unit.
    Returns `x_centre, y_centre`: in the samples' units; `density`: rows go with y [-]; `heights`: rising, one a share
    [-].
    """
    kept = thinned(np.column_stack([x, y]), KEPT).T
    beyond = MARGIN * np.ptp(kept, axis=1)
    x_centre, y_centre = np.linspace(kept.min(axis=1) - beyond, kept.max(axis=1) + beyond, BINS).T
    grid = np.array(np.meshgrid(x_centre, y_centre))
    density = gaussian_kde(kept)(grid.reshape(2, -1)).reshape(BINS, BINS)
    falling = np.sort(density.ravel())[::-1]
    enclosed = np.cumsum(falling) / falling.sum()
    heights = [float(falling[np.searchsorted(enclosed, share)]) for share in SHARES]
    return x_centre, y_centre, density, heights


def _grid(pressure_bar: np.ndarray, zero_bar: float) -> np.ndarray:
    """Pressures a little beyond the readings on both sides, as far as the air's properties are known [bar].

    `zero_bar`: absolute pressure from which they count.
    """
    low, high = float(pressure_bar.min()), float(pressure_bar.max())
    margin = max(0.06 * (high - low), 0.02)
    least, most = (limit - zero_bar for limit in PRESSURE_LIMITS_BAR)
    return np.linspace(max(low - margin, min(least, low)), min(high + margin, max(most, high)), GRID_POINTS)


def _variance(found: Fit, channel: str, errors: np.ndarray, noise_scale: np.ndarray) -> np.ndarray:
    """Noise and rounding of a reading over draws and rows, shape (n_draws, n), in the channel's unit squared."""
    column = column_of(found.recording, channel)
    if column is None:
        return np.zeros((len(errors), noise_scale.size))
    figures = found.recording.channels[column]
    factor = errors[:, ("pressure", "flow", "speed").index(channel), 2:3]
    return (figures.noise_sd * noise_scale * factor) ** 2 + figures.resolution**2 / 12.0


def _mixture(pressure_bar: np.ndarray, mean: np.ndarray, variance: np.ndarray, slope: np.ndarray) -> Expected:
    """Normal readings about each draw's mean, all draws alike; arrays of shape (n_draws, n)."""
    readings = (mean + NOISE_NODES[:, None, None] * np.sqrt(variance)).reshape(-1, pressure_bar.size)
    sd = np.sqrt(mean.var(axis=0) + variance.mean(axis=0))
    return Expected(pressure_bar, mean.mean(axis=0), sd, np.quantile(readings, LEVELS, axis=0), slope.mean(axis=0))


def _pressure_from_the_rest(rows: Rows, beside: dict[str, Expected], i: int) -> tuple[float, float]:
    """The pressure at which the model does what the speed (else the flow) reads: mean and sd [bar]."""
    channel = "speed" if rows.speed_state[i] == OBSERVED else "flow"
    here = beside[channel]
    difference = getattr(rows, channel)[i] - here.mean[i]
    return float(rows.pressure[i] + difference / here.slope_per_bar[i]), float(here.sd[i] / here.slope_per_bar[i])
