"""The joint likelihood of speed and flow, with the pressure an uncertain input.

A plateau's true pressure p is unknown; the gauge shows p (1 + scale) + offset + noise, rounded. Around the reading the
model is a straight line in p, so p is integrated out in closed form: speed and flow of a row are jointly normal with
the covariance

    diag(s_n^2, s_q^2) + s_p^2 d d^T,     d = (dn/dp, dq/dp),

where rounding to a resolution adds resolution^2 / 12. Offsets and scales are shared by the whole recording and are
sampled. Each of the three readings of a row may be bad, with probability `BAD` and a wide error; the eight cases are
summed, so a single bad reading is named and drags nothing. A reading off the instrument's scale, or a speed of 0,
enters as censored.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.data.measurement import Measurement, Rows
from calibration.likelihood.bad_reading import BAD
from calibration.systems.radial_piston.batch import states as effect_states
from calibration.systems.radial_piston.batch.effects import Effects
from calibration.systems.radial_piston.batch.polynomials import Polynomials, n_terms, sum_rows_by
from calibration.systems.radial_piston.batch.rows import add_zero_rows, bad_rows, sum_rows
from calibration.unknowns.priors import (
    CHANNELS,
    Error,
    OfEffect,
    OfInstrument,
    OfRun,
    Unknown,
    column_of,
    factors_at,
    values_of,
)
from configs.units import BAR
from model import layout as at
from model.effects.laws import Chosen
from model.motor import QUANTITIES, Motor
from model.solvers import steady
from rig.recording import Recording

FEW_ROWS = 3  # with fewer no reading is looked on as bad: there is nothing to tell it by
FARTHEST = 8.0  # spreads of the points that polynomials are fitted to; farther out they go anywhere
POINTS_PER_TERM, MOST_RUN = 4, 0.75  # of them, that a rotor runs at
ERRORS = (Error.OFFSET, Error.SCALE, Error.NOISE)


class Likelihood:
    """Log posterior of a batch of parameter vectors, in the standard normal numbers of `calibration.unknowns.priors`.

    `bad`: probability that a reading is bad [-]; `BAD`, or 0 with fewer than `FEW_ROWS` rows, when left out.
    """

    def __init__(
        self,
        motor: Motor,
        recording: Recording,
        measured: Measurement,
        found: list[Unknown],
        bad: float | None = None,
        effects: Effects | None = None,
    ) -> None:
        self.unknowns = found
        self.measured = measured
        self.effects = effects
        self._first_of_effects = len(found) - (len(effects.unknowns()) if effects else 0)
        self._base = motor.vector()
        self._base[at.J_ADDED] = recording.added_inertia_kg_m2
        self._readings = motor.readings.vector()
        self._position = {name: i for i, name in enumerate(QUANTITIES)}
        self._bounds = [(i, motor.quantity(u.name)) for i, u in enumerate(found) if u.name in QUANTITIES]
        self._moving = [i for i, unknown in enumerate(found) if _moves_plateaus(unknown.of)]
        rows = measured.steady
        P_a = motor.si("ambient_pressure") / BAR
        nominal = (rows.pressure + np.where(rows.is_gauge, P_a, 0.0)) * BAR
        self._gas = steady.gas_table(motor, nominal)
        columns = [column_of(recording, channel) for channel in ("pressure", "flow", "speed")]
        channels = [recording.channels[column] if column else None for column in columns]
        noise_sd = np.array([channel.noise_sd if channel else 0.0 for channel in channels])  # bar, L/min, rpm
        resolution = np.array([channel.resolution if channel else 0.0 for channel in channels])
        share = bad if bad is not None else (BAD if len(rows) >= FEW_ROWS else 0.0)
        self._told = (noise_sd, resolution, share)
        self._steady, self._zero = _arrays(rows), _arrays(measured.zero)
        self.not_converged = 0

    def values(self, z: np.ndarray) -> np.ndarray:
        """Physical values of the unknowns, shape (n, n_unknowns), each in its own unit; ``z`` likewise [-]."""
        return values_of(self.unknowns, z)

    def factors(self, z: np.ndarray) -> np.ndarray:
        """What one unit of each coordinate multiplies its unknown by, near a point; `priors.factors_at`."""
        return factors_at(self.unknowns, z)

    def log_prob(self, z: np.ndarray) -> np.ndarray:
        """Log posterior density up to a constant, shape (n,) [-]. `z`, shape (n, n_unknowns): points [-]."""
        return -0.5 * np.sum(z * z, axis=1) + self.log_likelihood(z)

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """Log likelihood, shape (n,), -inf where a parameter leaves its physical bounds [-].

        `z`, shape (n, n_unknowns): points [-].
        """
        parameters, errors, inside = self._split(z)
        result = np.full(len(z), -np.inf)
        if inside.any():
            out = self.predict(parameters[inside], errors[inside], self.chosen(z[inside]))
            found = np.empty(out.shape[0])
            sum_rows(out, errors[inside], *self._told, *self._steady[:3], found)
            self._add_zero_rows(parameters[inside], errors[inside], found)
            failed = np.any(out[..., steady.STATUS] == steady.NOT_CONVERGED, axis=1) | ~np.isfinite(found)
            self.not_converged += int(failed.sum())
            result[inside] = np.where(failed, -np.inf, found)
        return result

    @property
    def points_wanted(self) -> int:
        """Points that polynomials are fitted to [-]."""
        return POINTS_PER_TERM * n_terms(len(self._moving))

    def polynomials(self, z: np.ndarray) -> Polynomials | None:
        """Polynomials in the place of the model; None where at many points a rotor stands or a bound is passed.

        `z`, shape (points_wanted, n_unknowns): points, about where the posterior has its mass [-].
        """
        parameters, errors, inside = self._split(z)
        if inside.any():
            out = self.predict(parameters[inside], errors[inside], self.chosen(z[inside]))
            runs = np.all(out[..., steady.STATUS] == steady.RUNNING, axis=1)
            if runs.sum() >= MOST_RUN * len(z):
                return Polynomials(self.values(z)[inside][runs][:, self._moving], out[runs])
        return None

    def log_prob_by(self, polynomials: Polynomials, z: np.ndarray) -> np.ndarray:
        """`log_prob` with polynomials in the place of the model, shape (n,) [-].

        `z`, shape (n, n_unknowns): points [-].
        """
        parameters, errors, inside = self._split(z)
        x = polynomials.coordinates(self.values(z)[:, self._moving])
        inside &= np.all(np.abs(x) < FARTHEST, axis=1)
        result = np.full(len(z), -np.inf)
        if inside.any():
            found = np.empty(int(inside.sum()))
            sum_rows_by(x[inside], polynomials.coefficients, errors[inside], *self._told, *self._steady[:3], found)
            self._add_zero_rows(parameters[inside], errors[inside], found)
            result[inside] = found - 0.5 * np.sum(z[inside] ** 2, axis=1)
        return result

    def _add_zero_rows(self, parameters: np.ndarray, errors: np.ndarray, found: np.ndarray) -> None:
        P_a = parameters[:, self._position["ambient_pressure"]] / BAR
        add_zero_rows(P_a, errors, *self._told[:2], *self._zero, found)

    def bad_probability(self, z: np.ndarray) -> np.ndarray:
        """Probability that each reading is bad, averaged over points, shape (n_rows, 3): pressure, flow, speed [-].

        `z`, shape (n, n_unknowns): draws from the posterior [-].
        """
        parameters, errors, _ = self._split(z)
        out = self.predict(parameters, errors, self.chosen(z))
        found = np.zeros((len(self.measured.steady), 3))
        bad_rows(out, errors, *self._told, *self._steady[:3], found)
        return found / len(z)

    def predict(self, parameters: np.ndarray, errors: np.ndarray, chosen: Sequence[Chosen] = ()) -> np.ndarray:
        """Steady states at each row's pressure reading, corrected for offset and scale; `steady.solve`'s array.

        `parameters`, shape (n, n_parameters): parameter sets [SI].
        `errors`, shape (n, 3, 3): offset [bar, L/min, rpm], scale [-] and noise scale [-] of pressure, flow and speed.
        `chosen`: the effects of each set, of `chosen`; nothing where the fit has none.
        """
        rows = self.measured.steady
        time = self.effects.time if self.effects else None
        return self.states(parameters, errors, chosen, rows.pressure, rows.is_gauge, self._gas, time)

    def states(
        self,
        parameters: np.ndarray,
        errors: np.ndarray,
        chosen: Sequence[Chosen],
        pressure_bar: np.ndarray,
        is_gauge: np.ndarray,
        gas: np.ndarray,
        time: np.ndarray | None,
    ) -> np.ndarray:
        """Steady states where the pressure gauge reads this; `steady.solve`'s array.

        `parameters`, shape (n, n_parameters): parameter sets [SI].
        `errors`, shape (n, 3, 3): as in `predict`.
        `pressure_bar`, shape (n_rows,): what the gauge reads [bar].
        `is_gauge`, shape (n_rows,): the pressure is counted from the ambient's.
        `gas`, shape (n_rows, 12): of `steady.gas_table`.
        `time`, shape (n_rows,): on the recording's clock [s]; effects alone ask for it.
        """
        true = (pressure_bar - errors[:, 0, 0:1]) / (1.0 + errors[:, 0, 1:2])
        above = np.where(is_gauge, parameters[:, self._position["ambient_pressure"]][:, None], 0)
        if self.effects is not None and time is not None:
            shown = true * BAR
            return effect_states.solve(self.effects.way, parameters, self._readings, shown, above, gas, chosen, time)
        P = true * BAR + above
        return steady.solve(parameters, self._readings, np.clip(P, 2e4, 2e6), gas, slopes=True)

    def chosen(self, z: np.ndarray) -> Sequence[Chosen]:
        """The effects at each point with their values; nothing where the fit has none.

        `z`, shape (n, n_unknowns): points [-].
        """
        return self.effects.chosen(self.values(z)[:, self._first_of_effects :]) if self.effects else ()

    def split(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parameter sets [SI], shape (n, n_parameters), and instrument errors, shape (n, 3, 3), of points ``z`` [-].

        `z`, shape (n, n_unknowns): points [-].
        """
        parameters, errors, _ = self._split(z)
        return parameters, errors

    def _split(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        values = self.values(z)
        parameters = np.repeat(self._base[None, :], len(z), axis=0)
        errors = np.zeros((len(z), 3, 3))
        errors[:, :, 2] = 1.0
        inside = np.ones(len(z), dtype=bool)
        for i, quantity in self._bounds:
            inside &= (values[:, i] >= quantity.low) & (values[:, i] <= quantity.high)
        if self.effects is not None:
            inside &= self.effects.inside(values[:, self._first_of_effects :])
        for i, unknown in enumerate(self.unknowns[: self._first_of_effects]):
            if unknown.name in self._position:
                parameters[:, self._position[unknown.name]] = values[:, i] * QUANTITIES[unknown.name].to_si
            elif isinstance(unknown.of, OfInstrument):
                errors[:, CHANNELS.index(unknown.of.channel), ERRORS.index(unknown.of.error)] = values[:, i]
        parameters[:, at.J] += parameters[:, at.J_ADDED]
        return parameters, errors, inside


def _moves_plateaus(of: OfInstrument | OfEffect | OfRun | None) -> bool:
    """Whether an unknown changes what the model expects at a gauge's reading."""
    if isinstance(of, OfInstrument):
        return of.channel == "pressure" and of.error != Error.NOISE
    return True


def _arrays(rows: Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Readings (n, 3), states (n, 3), noise scale (n,) and is_gauge (n,), contiguous for the compiled loops."""
    readings = np.column_stack([rows.pressure, rows.flow, rows.speed])
    states = np.column_stack([rows.pressure_state, rows.flow_state, rows.speed_state])
    return (
        np.ascontiguousarray(readings, dtype=np.float64),
        np.ascontiguousarray(states, dtype=np.int64),
        np.ascontiguousarray(rows.noise_scale, dtype=np.float64),
        np.ascontiguousarray(rows.is_gauge, dtype=np.bool_),
    )
