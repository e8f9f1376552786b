"""The sampler: the map that straightens a posterior, each move against a known Gaussian, and the chain on disk."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import emcee
import numpy as np
import pytest

from calibration.fit import moves, peak, sampling
from calibration.fit.sampling import Begun, Settings, sample
from calibration.fit.store import ChainError
from calibration.fit.transport import TransportMap
from tests.densities import log_normal

QUICK = Settings(seed=3, effective_samples=500, most_steps=1000, walkers=16)


def correlated(n: int) -> np.ndarray:
    """A covariance of n unknowns: sds from 0.2 to 1, neighbours correlated by 0.9."""
    sd = np.linspace(1.0, 0.2, n)
    return sd[:, None] * sd * 0.9 ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))


def banana(z: np.ndarray) -> np.ndarray:
    """z0 ~ N(0, 1), z1 ~ N(z0^2 / 2, 0.1), z2 ~ N(z1, 0.3): means 0, 1/2, 1/2; variances 1, 0.51, 0.60."""
    found: np.ndarray = log_normal(z[:, 0]) + log_normal(z[:, 1], z[:, 0] ** 2 / 2, 0.1)
    return found + log_normal(z[:, 2], z[:, 1], 0.3)


def twisted(z: np.ndarray) -> np.ndarray:
    """Two unknowns N(0, 1), four more (sd 0.05) bent over them: a map from few draws misses the ends."""
    bent = [0.5 * z[:, 0] * z[:, 1], 0.5 * z[:, 1] * z[:, 2], *[z[:, 0] * (z[:, 0] - z[:, 1]) / 2] * 2]
    found: np.ndarray = log_normal(z[:, :2]).sum(axis=1)
    return found + sum(log_normal(z[:, 2 + k], middle, 0.05) for k, middle in enumerate(bent))


def walls(z: np.ndarray) -> np.ndarray:
    """Two narrow lanes that cross, each as long as the prior: neither is a polynomial of the other."""
    across = np.logaddexp(log_normal(z[:, 0], 0.0, 0.003), log_normal(z[:, 1], 0.0, 0.003))
    return across + gaussian(z)


def gaussian(z: np.ndarray) -> np.ndarray:
    return -0.5 * np.sum(z * z, axis=1)


# The map


@pytest.fixture(scope="module")
def curved() -> TransportMap:
    """A map of a curved cloud, one of whose coordinates is a logarithm (seed 5)."""
    rng = np.random.default_rng(5)
    cloud = rng.standard_normal((2000, 4)) * (1.0, 0.7, 0.2, 0.05)
    cloud[:, 2] += 0.4 * cloud[:, 0] ** 2
    cloud[:, 3] += np.exp(0.5 * cloud[:, 1]) - cloud[:, 0] * cloud[:, 1]
    return TransportMap(cloud, np.array([1.0, 2.0, 1.2, 1.0]))


def test_push_and_pull_are_inverse(curved):
    e = np.random.default_rng(6).standard_normal((500, 4))
    np.testing.assert_allclose(curved.pull(curved.push(e)[0]), e, atol=1e-9)


def test_the_map_tells_its_volume(curved):
    def log_volume(e: np.ndarray) -> float:
        steps = 1e-5 * np.eye(4)
        return float(np.log(abs(np.linalg.det((curved.push(e + steps)[0] - curved.push(e - steps)[0]) / 2e-5))))

    assert curved.as_value.any()  # so that the volume does change from place to place
    at = np.random.default_rng(7).standard_normal((20, 4))
    told = curved.push(at)[1] - curved.push(np.zeros((1, 4)))[1]
    np.testing.assert_allclose([log_volume(e) - log_volume(np.zeros(4)) for e in at], told, atol=1e-5)
    assert np.ptp(told) > 0.02


def test_the_map_straightens_what_it_was_fitted_to():
    rng = np.random.default_rng(8)
    z0 = rng.standard_normal(4000)
    cloud = np.column_stack([z0, z0**2 / 2 + 0.1 * rng.standard_normal(4000)])
    e = TransportMap(cloud, np.ones(2)).pull(cloud)
    np.testing.assert_allclose(np.cov(e.T), np.eye(2), atol=0.01)
    assert abs(np.corrcoef(e[:, 0] ** 2, e[:, 1])[0, 1]) < 0.05


def test_the_map_is_as_wide_as_the_noise_that_it_was_fitted_to():
    """A coordinate whose sd another one sets, as a noise scale sets the width of the ridge."""
    rng = np.random.default_rng(10)
    scale = rng.standard_normal(4000)
    cloud = np.column_stack([scale, 0.1 * np.exp(0.6 * scale) * rng.standard_normal(4000)])
    e = TransportMap(cloud, np.ones(2)).pull(cloud)
    wide, narrow = e[scale > 1.0, 1].std(), e[scale < -1.0, 1].std()
    assert wide / narrow == pytest.approx(1.0, abs=0.15)


# The moves


def sampled(move: list, covariance: np.ndarray, steps: int, straightened: bool) -> tuple[np.ndarray, np.ndarray]:
    """Largest mean and least and largest sd, in sds of the target N(0, covariance); the seed is 9."""
    n = len(covariance)
    known = np.random.default_rng(9).multivariate_normal(np.zeros(n), covariance, 2000)
    shape = TransportMap(known, np.ones(n)) if straightened else None
    inverse = np.linalg.inv(covariance)

    def log_prob(e: np.ndarray) -> np.ndarray:
        z, log_volume = shape.push(e) if shape else (e, 0.0)
        return log_volume - 0.5 * np.sum((z @ inverse) * z, axis=1)

    start = shape.pull(known[:48]) if shape else known[:48]
    state = emcee.State(start, random_state=np.random.RandomState(9).get_state())
    sampler = emcee.EnsembleSampler(48, n, log_prob, vectorize=True, moves=move)
    sampler.run_mcmc(state, steps)
    e = sampler.get_chain(flat=True, discard=steps // 20)
    sd = np.sqrt(np.diag(covariance))
    z = (shape.push(e)[0] if shape else e) / sd
    return z.mean(axis=0), z.std(axis=0)


MOVES = {type(move).__name__: [(move, 1.0)] for move, _ in moves.mixture()} | {"mixture": moves.mixture()}
# Steps of differential evolution and of independent proposals: the Monte-Carlo error of a sd is then at most 1 %.
STEPS = {2: (2000, 800), 6: (2500, 800), 15: (6000, 600)}


@pytest.mark.parametrize("covariance", [np.eye, correlated], ids=["standard", "correlated"])
@pytest.mark.parametrize("n", STEPS)
@pytest.mark.parametrize("name", MOVES)
def test_a_move_samples_a_known_gaussian(name, n, covariance):
    """Independent proposals need the map where the target is correlated; differential evolution does not."""
    alone = name == "DEMove"
    mean, sd = sampled(MOVES[name], covariance(n), STEPS[n][0 if alone else 1], covariance is correlated and not alone)
    np.testing.assert_allclose(mean, 0.0, atol=0.05)
    np.testing.assert_allclose(sd, 1.0, atol=0.03)


def test_emcees_snooker_move_fails_that_test_for_it_samples_too_narrow():
    _, sd = sampled([(emcee.moves.DESnookerMove(), 1.0)], np.eye(6), 1000, straightened=False)
    assert sd.max() < 0.9


def test_differences_of_a_fixed_set_sample_a_curved_target_that_the_set_does_not_look_like():
    def curved(z: np.ndarray) -> np.ndarray:
        """z0 ~ N(0, 1), z1 ~ N(z0^2 / 2, 0.5): means 0 and 1/2, variances 1 and 0.75."""
        return log_normal(z[:, 0]) + log_normal(z[:, 1], z[:, 0] ** 2 / 2, 0.5)

    known = np.random.default_rng(11).standard_normal((2000, 2)) * (1.3, 0.5)
    state = emcee.State(known[:48], random_state=np.random.RandomState(10).get_state())
    sampler = emcee.EnsembleSampler(48, 2, curved, vectorize=True, moves=[(moves.DifferenceMove(known), 1.0)])
    sampler.run_mcmc(state, 8000)
    flat = sampler.get_chain(flat=True, discard=400)
    np.testing.assert_allclose(flat.mean(axis=0), [0.0, 0.5], atol=0.03)
    np.testing.assert_allclose(flat.var(axis=0), [1.0, 0.75], rtol=0.06)


def aside(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draws of a narrow branch beside N(0, I) in three dimensions, five sds off along the first."""
    return np.array([5.0, 1.0, 0.0]) + 0.2 * rng.standard_normal((n, 3))


def test_independent_proposals_into_a_branch_too_sample_what_has_none():
    near = np.array([2.0, 0.0, 0.0]) + 0.5 * np.random.default_rng(13).standard_normal((200, 3))
    mean, sd = sampled([(moves.IndependenceMove(10.0, 1.1, moves.Branch(near)), 1.0)], np.eye(3), 1500, False)
    np.testing.assert_allclose(mean, 0.0, atol=0.02)
    np.testing.assert_allclose(sd, 1.0, atol=0.02)


def branched(z: np.ndarray) -> np.ndarray:
    """N(0, I), and beside it one sample in twenty of `aside`."""
    beside = log_normal(z - [5.0, 1.0, 0.0], 0.0, 0.2).sum(axis=1)
    found: np.ndarray = np.logaddexp(np.log(0.95) + log_normal(z).sum(axis=1), np.log(0.05) + beside)
    return found


def of_branched(asked: list[int], folder: Path | None = None, **changed: float) -> sampling.Chain:
    """A chain whose moves reach the branch no sooner than they are made anew; each time is counted."""
    rng = np.random.default_rng(14)
    start = np.concatenate([rng.standard_normal((180, 3)), aside(rng, 60)])

    def again(points: np.ndarray) -> sampling.Moves:
        asked.append(len(points))
        return lambda: [(moves.IndependenceMove(20.0, 1.05, moves.Branch(points[points[:, 0] > 4.0])), 1.0)]

    begun = Begun(start, lambda: [(moves.IndependenceMove(), 1.0)], again)
    settings = Settings(seed=5, effective_samples=20_000, most_steps=2000, walkers=48, times_tau=10.0, block=5)
    return sample(branched, 3, np.ones_like, replace(settings, **changed), folder, begun=begun)


def test_a_branch_that_holds_walkers_is_taken_up_and_gets_its_share():
    asked: list[int] = []
    chain = of_branched(asked)
    assert chain.converged and len(asked) == 1
    assert np.mean(chain.flat()[:, 0] > 4.0) == pytest.approx(0.05, abs=0.008)


def test_a_chain_goes_on_to_the_same_bits_after_a_branch_was_taken_up(tmp_path):
    asked: list[int] = []
    assert not of_branched(asked, tmp_path, most_steps=100).converged
    assert len(asked) == 1
    assert of_branched(asked, tmp_path).samples.tobytes() == of_branched(asked).samples.tobytes()


def test_a_stand_in_that_is_wrong_of_a_branch_changes_nothing_of_what_is_sampled():
    """It has four times as much there as there is."""

    def wrong(z: np.ndarray) -> np.ndarray:
        beside = log_normal(z - [5.0, 1.0, 0.0], 0.0, 0.2).sum(axis=1)
        found: np.ndarray = np.logaddexp(np.log(0.8) + log_normal(z, 0.1, 1.1).sum(axis=1), np.log(0.2) + beside)
        return found

    rng = np.random.default_rng(15)
    known = rng.standard_normal((1800, 3))
    chosen = moves.delayed(wrong, TransportMap(known, np.ones(3)), np.concatenate([known, aside(rng, 200)]))
    state = emcee.State(known[:96], random_state=np.random.RandomState(9).get_state())
    sampler = emcee.EnsembleSampler(96, 3, branched, vectorize=True, moves=chosen)
    sampler.run_mcmc(state, 800)
    assert np.mean(sampler.get_chain(flat=True, discard=50)[:, 0] > 4.0) == pytest.approx(0.05, abs=0.008)


def test_where_a_stand_in_proposes_each_walker_goes_its_own_way():
    """So that R-hat may be taken between walkers of one ensemble."""
    known = np.random.default_rng(12).standard_normal((500, 3))
    shape = TransportMap(known, np.ones(3))

    def chain(first: float) -> np.ndarray:
        start = known[:12].copy()
        start[0] = first
        state = emcee.State(start, random_state=np.random.RandomState(9).get_state())
        chosen = moves.delayed(gaussian, shape, known)
        sampler = emcee.EnsembleSampler(12, 3, banana, vectorize=True, moves=chosen)
        sampler.run_mcmc(state, 60)
        return sampler.get_chain()

    one, other = chain(0.1), chain(0.7)
    assert np.any(one[:, 0] != other[:, 0])
    np.testing.assert_array_equal(one[:, 1:], other[:, 1:])


# Whole chains


@pytest.fixture(scope="module")
def of_banana() -> sampling.Chain:
    return sample(banana, 3, np.ones_like, Settings(seed=2, effective_samples=10_000, most_steps=1500))


def test_a_curved_target_has_its_known_moments(of_banana):
    flat = of_banana.flat()
    assert of_banana.converged
    np.testing.assert_allclose(flat.mean(axis=0), [0.0, 0.5, 0.5], atol=0.03)
    np.testing.assert_allclose(flat.std(axis=0), np.sqrt([1.0, 0.51, 0.60]), rtol=0.03)
    assert np.mean((flat[:, 1] - flat[:, 0] ** 2 / 2) ** 2) == pytest.approx(0.01, rel=0.05)


def test_a_gaussian_target_has_its_known_moments():
    inverse = np.linalg.inv(correlated(6))
    chain = sample(
        lambda z: -0.5 * np.sum((z @ inverse) * z, axis=1), 6, np.ones_like, Settings(effective_samples=10_000)
    )
    sd = np.sqrt(np.diag(correlated(6)))
    np.testing.assert_allclose(chain.flat().mean(axis=0) / sd, 0.0, atol=0.03)
    np.testing.assert_allclose(np.cov(chain.flat().T) / np.outer(sd, sd), correlated(6) / np.outer(sd, sd), atol=0.04)


def test_a_converged_chain_is_long_agrees_between_ensembles_and_has_the_samples_asked_for(of_banana):
    ensembles, steps, walkers, _ = of_banana.samples.shape
    assert steps >= 50 * of_banana.tau.max()
    assert of_banana.rhat.max() <= 1.01
    assert of_banana.effective.min() >= 10_000
    np.testing.assert_allclose(of_banana.effective * of_banana.tau, ensembles * steps * walkers)
    assert 0.1 < of_banana.acceptance < 0.95


def test_the_autocorrelation_time_is_that_of_a_known_process():
    """AR(1) with coefficient 0.8: tau = (1 + 0.8) / (1 - 0.8) = 9 (seed 4)."""
    rng = np.random.default_rng(4)
    samples = np.empty((4, 2000, 16, 1))
    samples[:, 0] = rng.standard_normal((4, 16, 1))
    for i in range(1, 2000):
        samples[:, i] = 0.8 * samples[:, i - 1] + 0.6 * rng.standard_normal((4, 16, 1))
    tau = sampling._tau(samples)
    assert tau[0] == pytest.approx(9.0, rel=0.05)


def test_walkers_that_never_move_are_no_sign_of_a_short_autocorrelation_time():
    still = np.repeat(np.random.default_rng(4).standard_normal((4, 1, 16, 1)), 400, axis=1)
    assert sampling._tau(still)[0] > 100.0


def test_ensembles_in_different_modes_are_reported_as_not_converged(monkeypatch):
    """Four narrow modes far apart, one ensemble started in each: every ensemble alone looks well."""
    centres = 3.0 * np.eye(6)[:4]

    def modes(z: np.ndarray) -> np.ndarray:
        return np.logaddexp.reduce([-0.5 * np.sum((z - c) ** 2, axis=1) / 0.05**2 for c in centres], axis=0)

    def started(log_prob, n_unknowns, settings, begun):
        coords = centres[:, None, :] + 0.05 * np.random.default_rng(settings.seed).standard_normal((4, 16, 6))
        values = modes(coords.reshape(-1, 6)).reshape(4, 16)
        block = usual(log_prob, n_unknowns, settings, begun)
        return block | {"coords": coords, "log_prob": values, "population": coords.reshape(-1, 6)}

    usual = sampling._start
    monkeypatch.setattr(sampling, "_start", started)
    # Long enough and with samples enough, so that the ensembles alone speak against it.
    few = Settings(effective_samples=10, times_tau=0.1, most_steps=400, walkers=16)
    chain = sample(modes, 6, np.ones_like, few)
    assert chain.effective.min() >= 10 and chain.samples.shape[1] >= 0.1 * chain.tau.max()
    assert chain.rhat.max() > 1.5
    assert not chain.converged


def test_a_warm_up_that_proves_too_short_is_doubled_and_the_chain_no_longer_sticks():
    settings = Settings(seed=3, effective_samples=500, most_steps=2000, walkers=16, warm_up_blocks=1)
    told = []
    chain = sample(twisted, 6, np.ones_like, settings, progress=lambda done, wanted, words: told.append(words))
    assert "warm-up, longer" in told
    assert chain.steps - chain.drawn in {25 * 2**k for k in (1, 2, 3)}
    assert chain.converged
    assert chain.samples[..., 5].mean() == pytest.approx(0.5, abs=0.1)


def test_no_more_than_eight_warm_ups_are_spent_on_a_target_that_no_map_reaches():
    settings = Settings(seed=3, effective_samples=10**6, most_steps=1000, walkers=16, warm_up_blocks=1)
    chain = sample(walls, 2, np.ones_like, settings)
    assert not chain.converged
    assert chain.steps - chain.drawn == 8 * 25


def test_a_spent_budget_is_reported_as_not_converged():
    chain = sample(banana, 3, np.ones_like, Settings(effective_samples=10**6, most_steps=100, walkers=16))
    assert not chain.converged
    assert chain.steps == 100 + 7 * 25


@pytest.mark.filterwarnings("error")
def test_no_walker_stands_where_the_target_is_impossible_and_a_corner_has_its_known_mean():
    def corner(z: np.ndarray) -> np.ndarray:
        return np.where((z > 0.0).all(axis=1), gaussian(z), -np.inf)

    chain = sample(corner, 3, np.ones_like, QUICK)
    assert (chain.samples > 0.0).all()
    assert chain.flat().mean(axis=0) == pytest.approx([np.sqrt(2.0 / np.pi)] * 3, abs=0.08)


def test_a_peak_about_which_nothing_is_possible_is_said_so(monkeypatch):
    monkeypatch.setattr(peak, "scatter", lambda log_prob, top, spread, rng, n: np.full((n, 2), np.inf))
    with pytest.raises(peak.NoPeakError, match="hardly a point"):
        sample(lambda z: np.where(np.isfinite(z).all(axis=1), gaussian(z), -np.inf), 2, np.ones_like, QUICK)


def test_a_target_that_no_candidate_reaches_is_said_so():
    with pytest.raises(peak.NoPeakError, match="no point of the prior"):
        sample(lambda z: np.full(len(z), -np.inf), 2, np.ones_like, QUICK)


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not():
    first, again = (sample(banana, 3, np.ones_like, QUICK) for _ in range(2))
    other = sample(banana, 3, np.ones_like, Settings(seed=4, effective_samples=500, most_steps=1000, walkers=16))
    assert first.samples.tobytes() == again.samples.tobytes()
    assert not np.isin(first.samples[:, :5], other.samples).any()


def test_progress_is_told_in_effective_samples_of_those_wanted():
    told = []
    sample(banana, 3, np.ones_like, QUICK, progress=lambda done, wanted, words: told.append((done, wanted, words)))
    assert told[0] == (0, 500, "finding the peak")
    assert told[-1][0] >= 500
    assert [wanted for _, wanted, _ in told] == [500] * len(told)


# The chain on disk


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, bytes]:
    """A finished chain's folder, and its samples."""
    folder = tmp_path_factory.mktemp("finished") / "chain"
    return folder, sample(banana, 3, np.ones_like, QUICK, folder, "ours").samples.tobytes()


@pytest.fixture
def whole(finished, tmp_path: Path) -> tuple[Path, bytes]:
    """A copy of it, to be spoilt."""
    folder, samples = finished
    shutil.copytree(folder, tmp_path / "chain")
    return tmp_path / "chain", samples


def blocks(folder: Path) -> list[Path]:
    return sorted(folder.glob("block_*.npz"))


def counted() -> tuple[list[int], object]:
    """The banana, and a list that grows with its evaluations."""
    calls: list[int] = []

    def log_prob(z: np.ndarray) -> np.ndarray:
        calls.append(len(z))
        return banana(z)

    return calls, log_prob


def test_a_chain_with_a_longer_warm_up_is_continued_to_the_bits_of_an_uninterrupted_one(tmp_path):
    settings = Settings(seed=3, effective_samples=500, most_steps=2000, walkers=16, warm_up_blocks=1)
    whole = sample(twisted, 6, np.ones_like, settings, tmp_path, "ours")
    assert whole.steps - whole.drawn > 25
    for kept in (2, 3, 5):
        for block in blocks(tmp_path)[kept:]:
            block.unlink()
        again = sample(twisted, 6, np.ones_like, settings, tmp_path, "ours")
        assert again.samples.tobytes() == whole.samples.tobytes()


@pytest.mark.parametrize("kept", [1, 4, 9])
def test_a_chain_is_continued_to_the_bits_of_an_uninterrupted_one(whole, kept):
    folder, samples = whole
    for block in blocks(folder)[kept:]:
        block.unlink()
    assert sample(banana, 3, np.ones_like, QUICK, folder, "ours").samples.tobytes() == samples


def test_a_finished_chain_is_read_and_not_drawn_again(whole):
    folder, samples = whole
    before = len(blocks(folder))
    calls, log_prob = counted()
    assert sample(log_prob, 3, np.ones_like, QUICK, folder, "ours").samples.tobytes() == samples
    assert calls == []
    assert len(blocks(folder)) == before


def test_a_chain_is_made_longer_for_a_larger_target(whole):
    folder, _ = whole
    before = len(blocks(folder))
    target = Settings(seed=3, effective_samples=8000, most_steps=4000, walkers=16)
    chain = sample(banana, 3, np.ones_like, target, folder, "ours")
    assert chain.effective.min() >= 8000
    assert len(blocks(folder)) > before
    assert chain.samples.tobytes() == sample(banana, 3, np.ones_like, target).samples.tobytes()


def test_the_chain_of_another_fit_is_refused_and_kept(whole):
    folder, _ = whole
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ChainError, match="another recording, motor, setting or version"):
        sample(banana, 3, np.ones_like, QUICK, folder, "theirs")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_torn_partial_file_is_ignored(whole):
    folder, samples = whole
    last = blocks(folder)[-1]
    (folder / ".spinbench-torn").write_bytes(last.read_bytes()[:1000])
    last.unlink()
    assert sample(banana, 3, np.ones_like, QUICK, folder, "ours").samples.tobytes() == samples


@pytest.mark.parametrize("size", [0, 1000])
def test_a_block_that_cannot_be_read_is_named(whole, size):
    folder, _ = whole
    block = blocks(folder)[3]
    block.write_bytes(block.read_bytes()[:size])
    with pytest.raises(ChainError, match=r"block_00003\.npz: cannot be read"):
        sample(banana, 3, np.ones_like, QUICK, folder, "ours")


def test_a_chain_without_a_folder_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sample(banana, 3, np.ones_like, QUICK)
    assert not list(tmp_path.iterdir())


def test_a_chain_of_which_nothing_says_whose_it_is_is_refused(whole):
    folder, _ = whole
    (folder / "fingerprint").unlink()
    with pytest.raises(ChainError, match="nothing says whose it is"):
        sample(banana, 3, np.ones_like, QUICK, folder, "ours")


def test_ctrl_c_ends_a_fit_without_a_word_of_the_samplers(capsys):
    """emcee would print every point, and a traceback, for whatever goes wrong in the likelihood."""
    calls = 0

    def stopped(z):
        nonlocal calls
        calls += 1
        if calls == 400:
            raise KeyboardInterrupt
        return banana(z)

    with pytest.raises(KeyboardInterrupt):
        sample(stopped, 3, np.ones_like, QUICK)
    assert calls == 400
    assert capsys.readouterr().out == ""


def test_a_chain_shorter_than_its_autocorrelation_asks_is_not_converged():
    """With samples enough and agreeing ensembles."""
    few = Settings(seed=3, effective_samples=10, most_steps=100, walkers=16)
    short = sample(banana, 3, np.ones_like, few)
    assert short.effective.min() > 10 and short.rhat.max() <= sampling.RHAT
    assert short.samples.shape[1] < 50 * short.tau.max()
    assert not short.converged
    assert sample(banana, 3, np.ones_like, Settings(**{**vars(few), "times_tau": 1.0})).converged
