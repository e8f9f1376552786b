"""Where a search may start that would otherwise end elsewhere: angles, lines of runs in time, levels that stand."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from calibration.likelihood.function import Function
from calibration.likelihood.mode import cost_at, minus_log_posterior
from calibration.systems.radial_piston.predict.in_time import follows_angle
from calibration.systems.radial_piston.predict.kinds import LINE, RUN
from calibration.systems.radial_piston.predict.problem import Prediction
from calibration.systems.radial_piston.predict.supply import LATE_SD, own_of_line, ways_of
from calibration.work.threads import each

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

TURNS = 0.3  # share of the speed read above which a level is taken to turn
NOT_NOISE = 5.0  # sds of noise, or digits, above which a speed is not that of a rotor at rest
LOOSENS = ("roller_friction", "port_lap")  # what keeps a level standing
LOOSER, LOOSER_BY = 24, 0.25  # steps of it with which a level that stands is made to turn [-]
EDGE = math.sqrt(3.0)  # half a turn of the shaft, in sds of the angle's prior
ALL_ROUND = np.arange(1, 12) * EDGE / 6.0  # angles tried, beside the one that there is
LATE_S = (-0.12, 0.5, 0.03)  # from, to, step; moments at which a line begins to move, tried likewise,
SLOW = np.arange(-1.5, 2.1, 0.7)  # ... with time constants, in sds of their prior
LOUDER, FOLLOWED, MOST_LOOKS = 10.0, 3, 12  # factor on the noise meanwhile, lines that are followed, steps of each
RELOOKS, GAINS = 25, 1.0  # steps of a run that is looked at once more, and by how much its squares have to shrink
FAR_OFF = 1e4  # noise sds; farther off is no worse


def turned(
    comparison: Comparison, f: Function, z: np.ndarray, u: np.ndarray, here: Prediction
) -> tuple[np.ndarray, Prediction]:
    """A point with each of its angles at the best of a few, and the prediction there.

    `z`, shape (n,): the point [-].
    `u`, shape (5,): the noise [-].
    """
    if not follows_angle(f.names):
        return z, here
    for run in range(len(comparison.problem.blocks.runs)):
        place = comparison.problem.place(f"{comparison.problem.blocks.runs[run].file}.turn")
        if place is None:
            continue
        white = comparison.whitener(here, u)
        best = cost_at(comparison, z, u, here)
        angles = (float(z[place]) + ALL_ROUND + EDGE) % (2.0 * EDGE) - EDGE
        for tried, there in each(functools.partial(_at_angle, f, z, here, place, run), angles):
            r = white(comparison.read - comparison.raw(there))
            cost = minus_log_posterior(r, white.log_scale, tried, u, comparison)
            if cost < best:
                best, z, here = cost, tried, there
    return z, here


def with_lines(comparison: Comparison, f: Function, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A point with the line of each run where it suits the readings best, all else as it is [-], shape (n,).

    `z`, shape (n,): the point [-].
    `u`, shape (5,): the noise [-].
    """
    for run in range(len(comparison.problem.blocks.runs)):
        z = _with_line(comparison, f, z, u, run)
    return z


def relined(comparison: Comparison, f: Function, z: np.ndarray, u: np.ndarray) -> np.ndarray | None:
    """A point with all of a run's own unknowns where they suit the readings best, searched from their prior's middle.

    A line that the search left in a corner of its priors is found so, once the motor is about right.

    `z`, shape (n,): the point [-].
    `u`, shape (5,): the noise [-].
    Returns the point [-], shape (n,); None where no run is followed better so.
    """
    problem, here = comparison.problem, f(z, smooth=True)
    of_run = [problem.run_of(i) for i in range(f.k)]
    own = [
        _Own(comparison, f, z, u, here, run, [i for i in range(f.k) if of_run[i] == run])
        for run in range(len(problem.blocks.runs))
    ]
    found, gained = z.copy(), False
    for one, end in zip(own, each(lambda one: one.followed(np.zeros(len(one.places)), RELOOKS), own), strict=True):
        if 2.0 * end.cost < float(np.sum(one(z[one.places]) ** 2)) - GAINS:
            found[one.places], gained = end.x, True
    return f.clip(found) if gained else None


def loosened(comparison: Comparison, f: Function, z: np.ndarray, here: Prediction, D: np.ndarray) -> list[np.ndarray]:
    """Points at which each level that was seen to turn does: with less roller friction, or with less lap.

    The point itself where they turn already, or where neither helps.

    `z`, shape (n,): the point [-].
    `D`, shape (m, n): derivatives there [SI].
    """
    names = [unknown.name for unknown in comparison.problem.nuisances]
    speeds = slice(comparison.n, 2 * comparison.n)
    known, read = comparison.known[speeds], np.nan_to_num(comparison.read[speeds])
    problem, friction = comparison.problem, names.index("f_overall")
    seen = read > NOT_NOISE * max(problem.noise["speed"], problem.resolution["speed"])

    def turns(tried: np.ndarray) -> bool:
        speed = f(tried, here, ()).speed[seen]
        return bool(np.all(np.isfinite(speed)) and np.all(speed > TURNS * read[seen]))

    if turns(z):
        return [z]
    found, g = [], D[speeds, friction][known]
    for place in (names.index(name) for name in LOOSENS):
        # f_overall goes up with it, so that the other levels stay where they are.
        instead = float(g @ D[speeds, place][known]) / max(float(g @ g), 1e-30)
        tried = z.copy()
        for _ in range(LOOSER):
            tried = tried.copy()
            tried[place] -= LOOSER_BY
            tried[friction] += instead * LOOSER_BY
            tried = f.along_valley(z, f.clip(tried), here, D)
            if turns(tried):
                found.append(tried)
                break
    return found or [z]


def _with_line(comparison: Comparison, f: Function, z: np.ndarray, u: np.ndarray, run: int) -> np.ndarray:
    """A point with the line of one run where it suits the readings best.

    The moment at which it begins to move may be anywhere at first: a few are tried, with several time constants, by a
    cost in which the noise is louder, and the best of them followed.
    """
    problem = comparison.problem
    names = [one.name for one in problem.nuisances]
    moved = problem.blocks.runs[run]
    places = [names.index(name) for name in own_of_line(moved.file) if name in names]
    misfit = _Own(comparison, f, z, u, f(z, smooth=True), run, places)

    begun = []
    for way in ways_of(moved):
        late, slow = (names.index(f"{moved.file}.{way}_{what}") for what in ("late", "time"))
        sd = problem.nuisances[late].b
        more = math.sqrt(3.0 * max(sd * sd - LATE_SD * LATE_SD, 0.0))  # half of the time in which there was no row
        for when in np.arange(LATE_S[0] - more, LATE_S[1] + more, LATE_S[2]) / sd:
            for constant in SLOW:
                own = z[places].copy()
                own[[places.index(late), places.index(slow)]] = when, constant
                begun.append(own)
    sizes = each(lambda own: float(np.sum(np.log1p((misfit(own) / LOUDER) ** 2))), begun)
    best = [begun[k] for k in np.argsort(sizes)[:FOLLOWED]]
    ends = each(lambda own: misfit.followed(own, MOST_LOOKS), best)
    found = z.copy()
    if ends:
        found[places] = min(ends, key=lambda end: end.cost).x
    return found


class _Own:
    """How far a run and all that is read of lines are off [-], with some of the unknowns elsewhere, and these."""

    def __init__(
        self,
        comparison: Comparison,
        f: Function,
        z: np.ndarray,
        u: np.ndarray,
        here: Prediction,
        run: int,
        places: list[int],
    ) -> None:
        self.comparison, self.f, self.z, self.here, self.run, self.places = comparison, f, z, here, run, places
        self.white = comparison.whitener(here, u)
        self.mine = comparison.known & np.isin(comparison.kind, (RUN + run, LINE))

    def __call__(self, own: np.ndarray) -> np.ndarray:
        tried = self.z.copy()
        tried[self.places] = own
        found = self.f(self.f.clip(tried), self.here, (self.run,), smooth=True)
        left = self.white(self.comparison.read - np.nan_to_num(self.comparison.raw(found)))[self.mine]
        return np.append(np.clip(left, -FAR_OFF, FAR_OFF), own)

    def followed(self, own: np.ndarray, looks: int) -> OptimizeResult:
        """Where least squares lead from a start, in so many steps."""
        return least_squares(self, own, max_nfev=looks, diff_step=1e-3)


def _at_angle(
    f: Function, z: np.ndarray, here: Prediction, place: int, run: int, angle: float
) -> tuple[np.ndarray, Prediction]:
    """A point with one of its angles elsewhere, and the prediction there."""
    tried = z.copy()
    tried[place] = angle
    return tried, f(tried, here, (run,))
