"""The likelihood of a plateau against its own definition, integrated over the unknown pressure by brute force."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.stats import multivariate_normal, norm

from calibration.fit import fit, peak
from calibration.systems.radial_piston.batch.likelihood import Likelihood
from model.motor import Motor, read_motor
from model.solvers import steady
from rig.recording import read_recording

HEADER = "pressure_bar_abs,flow_l_min,speed_rpm\n"
RPM, L_MIN = 30.0 / np.pi, 6e4
# Instruments as tests/conftest.py declares them: pressure [bar], flow [L/min], speed [rpm].
NOISE, RESOLUTION = np.array([0.0015, 0.5, 0.4]), np.array([0.001, 0.5, 0.1])
BAD = 0.01
# A point away from the middle of every prior, in the unknowns' units.
SOMEWHERE = {
    "f_overall": 0.0601,
    "port_lap": 8.4,
    "pressure_offset": 0.004,
    "pressure_scale": -0.003,
    "pressure_noise_scale": 1.2,
    "flow_offset": 0.7,
    "flow_scale": 0.01,
    "flow_noise_scale": 0.8,
    "speed_offset": -0.1,
    "speed_scale": 0.0006,
    "speed_noise_scale": 1.3,
}


@pytest.fixture
def likelihood_of(put_recording) -> Callable[..., tuple[Motor, Likelihood]]:
    def prepare(*files: tuple[str, str, str], **more: str) -> tuple[Motor, Likelihood]:
        recording = read_recording(put_recording(*files, **more))
        motor, measured, usual = fit.prepare(recording)
        return motor, Likelihood(
            motor, recording, measured, usual.unknowns, bad=BAD
        )  # bad readings in a single row too

    return prepare


def at(likelihood: Likelihood, values: Mapping[str, float]) -> np.ndarray:
    """The point, shape (1, n), at which the named unknowns have these values and the others the motor's."""
    known = {"f_overall": 0.0625} | dict(values)
    return np.array([[u.z(known[u.name]) if u.name in known else 0.0 for u in likelihood.unknowns]])


def readings_at(motor: Motor, pressure_bar: float) -> tuple[float, float]:
    """Flow [L/min] and speed [rpm] of perfect instruments at a true pressure."""
    found = steady.steady(motor, [pressure_bar * 1e5])
    return float(found.flow_m3_s[0, 0] * L_MIN), float(found.speed_rad_s[0, 0] * RPM)


# One row, integrated by hand


def channel_density(cell: str, shown: np.ndarray | float, sd: float) -> np.ndarray | float:
    """Probability (density) of one cell, when the instrument shows ``shown`` on the mean."""
    if cell == "":
        return 1.0
    if cell.startswith("<") or cell == "0":
        return norm.cdf((float(cell.strip("<")) - shown) / sd)
    if cell.startswith(">"):
        return norm.sf((float(cell[1:]) - shown) / sd)
    return norm.pdf(float(cell), shown, sd)


def by_brute_force(motor: Motor, cells: tuple[str, str, str]) -> float:
    """Log likelihood of one row at SOMEWHERE: good and bad cases, each integrated over the true pressure."""
    point = motor.with_values({name: SOMEWHERE[name] for name in ("f_overall", "port_lap")})
    p_read = float(cells[0])
    grid = np.linspace(p_read - 0.9, p_read + 0.9, 91)
    state = steady.steady(point, grid * 1e5)
    curves = [CubicSpline(grid, state.flow_m3_s[0] * L_MIN), CubicSpline(grid, state.speed_rad_s[0] * RPM)]
    offset, scale, noise = (
        np.array([SOMEWHERE[f"{channel}_{error}"] for channel in ("pressure", "flow", "speed")])
        for error in ("offset", "scale", "noise_scale")
    )
    good = np.sqrt((NOISE * noise) ** 2 + RESOLUTION**2 / 12.0)
    magnitude = np.array([abs(float(cell.strip("<>") or 0.0)) for cell in cells])
    centre = (p_read - offset[0]) / (1.0 + scale[0])
    total = 0.0
    for case in np.ndindex(2, 2, 2):
        if any(is_bad and cell == "" for is_bad, cell in zip(case, cells, strict=True)):
            continue
        sd = np.where(case, 10.0 * good + 0.1 * magnitude, good)
        width = sd[0] / (1.0 + scale[0])

        def integrand(p: float, sd: np.ndarray = sd, width: float = width) -> float:
            shown = [curve(p) * (1.0 + scale[i]) + offset[i] for i, curve in enumerate(curves, start=1)]
            flow, speed = (channel_density(cells[i], shown[i - 1], sd[i]) for i in (1, 2))
            return float(norm.pdf(p, centre, width) * flow * speed)

        low, high = max(grid[0], centre - 7.0 * width), min(grid[-1], centre + 7.0 * width)
        peaks = np.clip(
            [centre, *(curve_root(curve, cells[i], p_read) for i, curve in enumerate(curves, 1))], low, high
        )
        value = quad(integrand, low, high, points=np.unique(peaks), limit=400, epsabs=0.0, epsrel=1e-8)[0]
        total += BAD ** sum(case) * (1.0 - BAD) ** (3 - sum(case)) * value
    return float(np.log(total))


def curve_root(curve: CubicSpline, cell: str, otherwise: float) -> float:
    """The pressure at which a curve passes a reading, where the integrand may peak."""
    if not cell.strip("<>"):
        return otherwise
    roots = curve.solve(float(cell.strip("<>")), extrapolate=False)
    return float(roots[0]) if roots.size else otherwise


ROWS = {
    "all_good": ("2.0", "74.5", "409.6"),
    "a_sd_or_two_off": ("2.0", "75.0", "411.0"),
    "pressure_bad": ("2.1", "74.5", "409.6"),
    "flow_bad": ("2.0", "55.0", "409.6"),
    "speed_bad": ("2.0", "74.5", "350.0"),
    "flow_and_speed_bad": ("2.0", "55.0", "350.0"),
    "flow_missing": ("2.0", "", "410.0"),
    "speed_missing": ("2.0", "75.0", ""),
    "flow_below_scale": ("1.25", "<15", "88.5"),
    "flow_well_below_scale": ("1.25", "<10", "88.5"),
    "flow_above_scale": ("2.4", ">105", "585.0"),
    "speed_censored_alone": ("2.4", "", ">585"),
    "flow_seen_speed_censored": ("2.4", "107.0", ">585"),
}


@pytest.mark.parametrize("name", ROWS)
def test_a_row_has_the_likelihood_of_the_integral_over_its_pressure(likelihood_of, name):
    """The closed form takes the model as straight in the pressure; a bad one shows how straight it is."""
    cells = ROWS[name]
    motor, likelihood = likelihood_of(("sweep.csv", "steady", f"{HEADER}{','.join(cells)}\n"))
    found = likelihood.log_likelihood(at(likelihood, SOMEWHERE))[0]
    assert found == pytest.approx(by_brute_force(motor, cells), abs=0.1)


@pytest.mark.parametrize("cells", [("1.25", "<15", "<89"), ("2.4", ">105", ">580"), ("1.04", "<10", "0")])
def test_a_row_with_flow_and_speed_off_scale_has_nearly_that_likelihood(likelihood_of, cells):
    """The correlation that a shared pressure makes of two censored readings is left aside."""
    turning = f"{HEADER}2.0,72.9,397.1\n"  # without it a rotor at rest alone is refused
    motor, both = likelihood_of(("sweep.csv", "steady", f"{turning}{','.join(cells)}\n"))
    _, alone = likelihood_of(("sweep.csv", "steady", turning), name="alone")
    found = both.log_likelihood(at(both, SOMEWHERE))[0] - alone.log_likelihood(at(alone, SOMEWHERE))[0]
    assert found == pytest.approx(by_brute_force(motor, cells), abs=0.3)


def test_rows_multiply(likelihood_of):
    rows = [",".join(ROWS[name]) for name in ("all_good", "flow_bad", "flow_missing")]
    alone = []
    for i, row in enumerate(rows):
        _, one = likelihood_of(("sweep.csv", "steady", f"{HEADER}{row}\n{row}\n"), name=f"bench_{i}")
        alone.append(one.log_likelihood(at(one, SOMEWHERE))[0] / 2.0)
    _, likelihood = likelihood_of(("sweep.csv", "steady", HEADER + "".join(f"{row}\n" for row in rows)))
    assert likelihood.log_likelihood(at(likelihood, SOMEWHERE))[0] == pytest.approx(sum(alone), abs=1e-4)


def test_good_readings_have_the_gaussian_likelihood(likelihood_of):
    """Where no reading is off, the row is a bivariate normal whose covariance the pressure's noise makes."""
    motor, likelihood = likelihood_of(("sweep.csv", "steady", f"{HEADER}2.0,72.9,397.1\n"))
    flow, speed = readings_at(motor, 2.0)
    slopes = (np.array(readings_at(motor, 2.005)) - readings_at(motor, 1.995)) / 0.01
    var = NOISE**2 + RESOLUTION**2 / 12.0
    covariance = np.diag(var[1:]) + var[0] * np.outer(slopes, slopes)
    expected = multivariate_normal.logpdf([72.9, 397.1], [flow, speed], covariance) + 3.0 * np.log(1.0 - BAD)
    found = likelihood.log_likelihood(at(likelihood, {}))[0]
    assert found == pytest.approx(expected, abs=0.01)


def test_gauge_pressure_is_counted_from_the_ambient_of_the_point(likelihood_of):
    """With the barometer at 1.01625 bar, 0.98375 bar gauge are 2 bar absolute."""
    point = {"ambient_pressure": 101_625.0}
    flow, speed = readings_at(read_motor("ptm3600").with_values(point), 2.0)
    _, absolute = likelihood_of(("sweep.csv", "steady", f"{HEADER}2.0,{flow:.2f},{speed:.2f}\n"), name="absolute")
    gauge = HEADER.replace("abs", "gauge")
    _, relative = likelihood_of(("sweep.csv", "steady", f"{gauge}0.98375,{flow:.2f},{speed:.2f}\n"), name="gauge")
    found = relative.log_likelihood(at(relative, point))[0]
    assert found == pytest.approx(absolute.log_likelihood(at(absolute, point))[0], abs=0.01)


def test_a_noisier_files_rows_are_wider(likelihood_of, put_recording):
    folder = put_recording(("sweep.csv", "steady", f"{HEADER}2.0,,405.0\n"))
    _, _, usual = fit.prepare(read_recording(folder))
    with (folder / "recording.toml").open("a") as stream:
        stream.write("noise_scale = 10.0\n")
    _, _, noisy = fit.prepare(read_recording(folder))
    z = np.zeros((1, len(usual.unknowns)))
    assert noisy.log_likelihood(z)[0] > usual.log_likelihood(z)[0] + 1.0


# Zero rows


def test_zero_rows_show_the_offsets(likelihood_of):
    """Vented and at rest, a gauge shows the ambient, a flow meter 0: the likelihood's change is theirs alone."""
    sweep = ("sweep.csv", "steady", f"{HEADER}2.0,74.5,409.6\n")
    _, without = likelihood_of(sweep, name="without")
    _, likelihood = likelihood_of(sweep, ("zero.csv", "zero", "pressure_bar_abs,flow_l_min\n1.021,0.8\n,-0.3\n"))
    found = likelihood.log_likelihood(at(likelihood, SOMEWHERE)) - without.log_likelihood(at(without, SOMEWHERE))
    sd = np.sqrt((NOISE * [1.2, 0.8, 1.3]) ** 2 + RESOLUTION**2 / 12.0)
    expected = norm.logpdf(1.021, 1.01325 * 0.997 + 0.004, sd[0]) + norm.logpdf([0.8, -0.3], 0.7, sd[1]).sum()
    assert found[0] == pytest.approx(expected, abs=1e-6)


def test_a_vented_gauge_of_gauge_pressure_shows_its_offset(likelihood_of):
    sweep = ("sweep.csv", "steady", "pressure_bar_gauge,speed_rpm\n0.98675,397\n")
    _, without = likelihood_of(sweep, name="without")
    _, likelihood = likelihood_of(sweep, ("zero.csv", "zero", "pressure_bar_gauge\n0.006\n"))
    point = {"pressure_offset": 0.004, "ambient_pressure": 101_500.0}
    found = likelihood.log_likelihood(at(likelihood, point)) - without.log_likelihood(at(without, point))
    sd = np.hypot(0.0015, 0.001 / 12**0.5)
    assert found[0] == pytest.approx(norm.logpdf(0.006, 0.004, sd), abs=1e-6)


# Batches, bounds and the prior


@pytest.fixture
def sweep(likelihood_of) -> Likelihood:
    """A sweep of the default motor, as perfect instruments would show it."""
    return likelihood_of(("sweep.csv", "steady", sweep_of()))[1]


def sweep_of(bad: str = "") -> str:
    """Five plateaus of the default motor; the speed of row 3 may be replaced."""
    rows = []
    for i, p in enumerate([1.3, 1.6, 1.9, 2.2, 2.5], start=1):
        flow, speed = readings_at(read_motor("ptm3600").with_values({"relative_humidity": 0.5}), p)
        rows.append(f"{p},{flow:.2f},{bad if bad and i == 3 else f'{speed:.2f}'}\n")
    return HEADER + "".join(rows)


def test_a_batch_is_evaluated_as_its_points_one_by_one(sweep):
    z = 0.5 * np.random.default_rng(21).standard_normal((40, len(sweep.unknowns)))
    batch = sweep.log_prob(z)
    assert np.isfinite(batch).all()
    np.testing.assert_array_equal(batch, [sweep.log_prob(one[None, :])[0] for one in z])


def test_the_posterior_is_the_likelihood_times_the_standard_normal_prior(sweep):
    z = 0.5 * np.random.default_rng(22).standard_normal((5, len(sweep.unknowns)))
    prior = norm.logpdf(z).sum(axis=1) + 0.5 * z.shape[1] * np.log(2.0 * np.pi)
    np.testing.assert_allclose(sweep.log_prob(z), sweep.log_likelihood(z) + prior)


@pytest.mark.parametrize(("name", "value"), [("port_lap", 20.5), ("port_lap", 0.4), ("ambient_pressure", 4.9e4)])
def test_a_parameter_out_of_its_bounds_is_impossible(sweep, name, value):
    assert sweep.log_likelihood(at(sweep, {name: value}))[0] == -np.inf


def test_noise_beyond_all_reason_is_unlikely_and_no_error(sweep):
    """The search for the peak tries such points; speed and flow then differ by the pressure's error alone."""
    wild = {"pressure_noise_scale": 5e16, "flow_noise_scale": 4e-4, "speed_noise_scale": 3e-9}
    found = sweep.log_likelihood(at(sweep, wild))[0]
    assert np.isfinite(found)
    assert found < sweep.log_likelihood(at(sweep, {}))[0]


def test_an_impossible_point_leaves_its_neighbours_alone(sweep):
    z = np.vstack([at(sweep, {}), at(sweep, {"port_lap": 25.0}), at(sweep, {})])
    first, impossible, last = sweep.log_prob(z)
    assert first == last == sweep.log_prob(at(sweep, {}))[0]
    assert impossible == -np.inf


# Bad readings


def test_a_bad_reading_is_named_and_only_it(likelihood_of):
    _, likelihood = likelihood_of(("sweep.csv", "steady", sweep_of(bad="330.0")))
    found = likelihood.bad_probability(at(likelihood, {}))
    assert found.shape == (5, 3)
    assert found[2, 2] > 0.99
    found[2, 2] = 0.0
    assert found.max() < 0.05


def test_without_a_bad_reading_none_is_named(sweep):
    assert sweep.bad_probability(at(sweep, {})).max() < 0.01


def test_a_missing_reading_is_not_bad(likelihood_of):
    _, likelihood = likelihood_of(("sweep.csv", "steady", f"{HEADER}2.0,,397.0\n1.6,41.5,\n"))
    found = likelihood.bad_probability(at(likelihood, {}))
    assert found[0, 1] == found[1, 2] == 0.0


def test_a_bad_reading_does_not_drag_f_overall(likelihood_of, sweep):
    """A speed 17 % too low in one row of five; taken as good it would raise f_overall by about 3 %."""
    _, spoilt = likelihood_of(("sweep.csv", "steady", sweep_of(bad="295.0")), name="spoilt")
    index = [unknown.name for unknown in sweep.unknowns].index("f_overall")
    tops = [peak.find_peak(one.log_prob, at(one, {})) for one in (sweep, spoilt)]
    found = [float(sweep.values(top[None, :])[0, index]) for top in tops]
    assert found[1] == pytest.approx(found[0], rel=0.01)
    assert found[0] == pytest.approx(0.0625, rel=0.02)
