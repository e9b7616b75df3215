"""Samples of beliefs: ranks that are uniform for any exact belief, and main modes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from scipy.spatial.distance import pdist

from rangefix.evaluation import Experiment, NamedEstimator, load, run, streams, summarise
from rangefix.evaluation.consistency.belief_scores import (
    RANK_DRAWS,
    belief_arrays,
    draw_belief,
    main_mode,
    measure,
    rank_histogram,
)
from rangefix.evaluation.consistency.calibration import histogram, pit
from rangefix.evaluation.consistency.intervals import uniform_p_value
from rangefix.evaluation.consistency.scores import crps, energy_score
from rangefix.evaluation.figures import FigureData, plot_ranks
from rangefix.evaluation.figures.ranks import OUTSIDE
from rangefix.evaluation.figures.style import CLAIMED
from rangefix.evaluation.monte_carlo.simulate import simulate
from rangefix.evaluation.results import BeliefScores, FolderLayout, read_part, trials_path, write_part
from rangefix.filters import EachRun, build, pose_space, position_space
from rangefix.filters.optional_methods import CanSample, sample_belief

from ..conftest import PriorOnly, make_problem

SPACE = position_space(heading=0.0)


def ring(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on a noisy half ring about (0, 0): as far from Gaussian as beliefs from one beam are."""
    angle = rng.uniform(0, np.pi, size=count)
    radius = 2 + 0.1 * rng.normal(size=count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


@dataclass(frozen=True)
class Ring:
    """Believes in the ring, or in one that is too thin about its middle by `squeeze`."""

    squeeze: float = 1.0

    def sample(self, belief: Any, size: int, rng: np.random.Generator) -> np.ndarray:
        points = ring(size, rng)
        middle = np.array([0.0, 4 / np.pi])
        return middle + self.squeeze * (points - middle)


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    return ring(1000, np.random.default_rng(31))


def measured(truth: np.ndarray, squeeze: float) -> Any:
    lifted = EachRun(Ring(squeeze))  # type: ignore[type-var]
    draws = sample_belief(lifted, [None] * len(truth), RANK_DRAWS, streams(1, "belief", range(len(truth))))
    assert draws is not None
    return measure(draws, truth, SPACE)


def judged(estimator: Any, belief: Any, truth: np.ndarray, seed: int, runs: range) -> BeliefScores:
    """Draws from the beliefs of some runs against their truths (M, n)."""
    draws = draw_belief(estimator, belief, RANK_DRAWS, seed, runs, 0)
    assert draws is not None
    return measure(draws, truth, SPACE)


def test_ranks_of_an_exact_belief_are_uniform_though_it_is_no_gaussian(truth):
    """Chi-square p > 0.001 for both components and the distance: a correct belief fails 3 seeds in 1000."""
    found = measured(truth, 1.0)
    for ranks in (*found.ranks.T, found.distance_rank):
        assert uniform_p_value(rank_histogram(ranks)) > 1e-3


@pytest.mark.parametrize("squeeze", [0.8, 1.3])
def test_ranks_of_a_wrong_belief_are_not(truth, squeeze):
    """Negative control: too narrow and too wide."""
    found = measured(truth, squeeze)
    assert uniform_p_value(rank_histogram(found.distance_rank)) < 1e-6
    many = rank_histogram(found.distance_rank)[-1] / 100
    assert many > 1.5 if squeeze < 1 else many < 0.7


def test_energy_from_draws_agrees_with_the_gaussian_claim():
    """Draws from N(0, I): the mean over 2000 runs agrees with the closed form within 4 standard errors."""
    rng = np.random.default_rng(32)
    truth = rng.normal(size=(2000, 2))
    drawn = measure(rng.normal(size=(2000, 20, 2)), truth, SPACE).energy
    gap = drawn - energy_score(truth, np.broadcast_to(np.eye(2), (2000, 2, 2)))
    assert abs(gap.mean()) < 4 * gap.std() / np.sqrt(2000)


def test_a_run_s_draws_are_its_own(truth):
    """The same numbers alone and in a batch."""
    lifted = EachRun(Ring())  # type: ignore[type-var]
    whole = sample_belief(lifted, [None] * 3, 9, streams(1, "belief", range(3)))
    alone = sample_belief(lifted, [None], 9, streams(1, "belief", [2]))
    assert whole is not None
    assert alone is not None
    np.testing.assert_array_equal(whole[2:], alone)


def test_estimators_that_cannot_sample_are_let_be():
    assert sample_belief(object(), None, 9, streams(1, "belief", range(2))) is None
    assert not isinstance(object(), CanSample)


@pytest.mark.parametrize(("shape", "says"), [((2, 8, 2), "shape"), ((2, 9), "shape"), ((2, 9, 2), "finite")])
def test_bad_draws_are_refused(shape, says):
    class Bad:
        def sample(self, belief: Any, size: int, rngs: Any) -> Any:
            return np.full(shape, np.nan)

    with pytest.raises(ValueError, match=says):
        sample_belief(Bad(), None, 9, streams(1, "belief", range(2)))


def largest(points: np.ndarray) -> np.ndarray:
    return main_mode(pdist(points), len(points))


def test_main_mode():
    """Two clouds come apart, the larger one is found; a band, a ring and a Gaussian stay whole."""
    rng = np.random.default_rng(33)
    for _ in range(20):
        clouds = np.concatenate([rng.normal(size=(65, 2)) * 0.1, [4, 0] + rng.normal(size=(34, 2)) * 0.1])
        assert largest(clouds)[:65].mean() > 0.9
        assert not largest(clouds)[65:].any()
        band = rng.uniform(size=(99, 2)) * [4.0, 0.05]
        for whole in (band, ring(99, rng), rng.normal(size=(99, 2))):
            assert largest(whole).mean() > 0.9
    assert largest(np.zeros((5, 2))).all()


def test_whole_belief_and_main_mode_side_by_side():
    rng = np.random.default_rng(34)
    far = np.where(rng.uniform(size=(50, 99, 1)) < 0.7, 0.0, 4.0) * [1.0, 0.0]
    found = measure(far + 0.1 * rng.normal(size=(50, 99, 2)), np.zeros((50, 2)), SPACE)
    assert found.mode_share.mean() == pytest.approx(0.7, abs=0.05)
    assert np.sqrt(found.mode_covariance[:, 0, 0].mean()) == pytest.approx(0.1, rel=0.1)
    assert np.sqrt(found.spread[:, 0, 0].mean()) > 1.5


def test_angles_go_the_short_way_round():
    """Headings about pi: ranks are those of headings about 0."""
    rng = np.random.default_rng(35)
    draws, truth = rng.normal(size=(20, 99, 3)) * 0.1, rng.normal(size=(20, 3)) * 0.1
    space = pose_space()
    turned = np.array([0.0, 0.0, np.pi])
    straight, back = measure(draws, truth, space), measure(space.wrap(draws + turned), truth + turned, space)
    np.testing.assert_array_equal(straight.ranks, back.ranks)


def test_a_belief_in_a_single_point_is_outranked():
    found = measure(np.zeros((4, 99, 2)), np.ones((4, 2)), SPACE)
    assert found.distance_rank.tolist() == [99.0] * 4


def test_ranks_go_into_equal_bins():
    assert rank_histogram(np.arange(100)).tolist() == [10.0] * 10
    with pytest.raises(ValueError, match="equal bins"):
        rank_histogram(np.arange(9), draws=98)


def test_beliefs_survive_in_parts(tmp_path):
    """What a runner adds to a part is read again, (M, T, ...); a study without it has none."""
    results = run(Experiment(make_problem(), {"prior": PriorOnly}, runs=6, block=4), tmp_path, timing=False)
    assert results.trials[0].belief(0) is None
    assert summarise(results)[0].beliefs is None
    plan = FolderLayout.read(results.manifest)
    for first, end in plan.blocks():
        path = trials_path(tmp_path, "prior", "all", first, end)
        truth = results.truth[first:end, 0]
        found = judged(EachRun(Ring()), [None] * (end - first), truth, 1, range(first, end))  # type: ignore[type-var]
        write_part(path, read_part(path) | belief_arrays([found]), plan.key("prior", "all", first, end))
    again = load(tmp_path)
    found = again.trials[0].belief(0)
    assert found is not None
    assert found.ranks.shape == (6, 2)
    assert found.mode_covariance.shape == (6, 2, 2)
    assert np.isfinite(found.energy).all()
    beliefs = summarise(again)[0].beliefs
    assert beliefs is not None
    assert beliefs.energy.value == pytest.approx(found.energy.mean())
    assert beliefs.whole[1].value == pytest.approx(found.spread[:, 1, 1].mean())
    assert beliefs.mode[0].value == pytest.approx(found.mode_covariance[:, 0, 0].mean())
    assert beliefs.ranks.sum(1).tolist() == [6.0] * 3


def test_crps_from_draws_agrees_with_the_closed_form():
    """Draws from N(0, 1.5^2): the mean over 2000 runs agrees within 4 standard errors, in each component."""
    rng = np.random.default_rng(36)
    truth = rng.normal(size=(2000, 2))
    found = measure(1.5 * rng.normal(size=(2000, 20, 2)), truth, SPACE).crps
    gap = found - crps(truth, np.full(2, 1.5))
    assert (np.abs(gap.mean(0)) < 4 * gap.std(0) / np.sqrt(2000)).all()


def test_crps_of_a_heading_does_not_mind_where_the_circle_is_cut():
    """The same draws turned by any angle: the same score; and that of two modes is that of arcs, by hand."""
    rng = np.random.default_rng(37)
    space = pose_space()
    draws, truth = rng.uniform(-3, 3, size=(8, 30, 3)), rng.uniform(-3, 3, size=(8, 3))
    turn = np.array([0.0, 0.0, 2.5])
    turned = measure(space.wrap(draws + turn), space.wrap(truth + turn), space)
    np.testing.assert_allclose(turned.crps, measure(draws, truth, space).crps, atol=1e-12)
    two = np.zeros((1, 2, 3))
    two[0, 1, 2] = np.pi - 0.2  # half of |0.1 - 0| and of |0.1 - (pi - 0.2)|, less half of pi - 0.2
    expected = 0.5 * (0.1 + np.pi - 0.3) - 0.5 * (np.pi - 0.2)
    assert measure(two, np.array([[0.0, 0.0, 0.1]]), space).crps[0, 2] == pytest.approx(expected)


def test_ranks_of_headings_are_uniform_on_the_whole_circle():
    """Nothing is known of the heading: chi-square p > 0.001 over 2500 runs (1 seed in 1000 fails).

    Cut half a turn from the mean of the draws alone, the truth would have the outer ranks too often.
    """
    rng = np.random.default_rng(38)
    draws, truth = (rng.uniform(-np.pi, np.pi, size=(2500, *shape, 3)) for shape in ((RANK_DRAWS,), ()))
    found = measure(draws, truth, pose_space())
    assert uniform_p_value(rank_histogram(found.ranks[:, 2])) > 1e-3
    middle = np.arctan2(np.sin(draws[..., 2]).mean(1), np.cos(draws[..., 2]).mean(1))
    apart = (np.concatenate([draws, truth[:, None]], 1)[..., 2] - middle[:, None] + np.pi) % (2 * np.pi)
    naive = (apart[:, :-1] < apart[:, -1:]).sum(1)
    assert uniform_p_value(rank_histogram(naive)) < 1e-4


def test_copies_of_few_points_are_not_torn_apart():
    """Nine tenths of the draws are copies, as of a worn particle filter: one cloud is still one mode."""
    rng = np.random.default_rng(39)
    for _ in range(20):
        few = rng.normal(size=(8, 2))
        assert largest(few[rng.integers(8, size=99)]).mean() > 0.8


BUILT_IN: dict[str, dict[str, Any]] = {
    "point-mass": {"cell": 0.04},
    "particle": {"particles": 1000},
}


@pytest.fixture(scope="module")
def world() -> Any:
    """600 truths from the prior in the paper's room, and one reading of the first beam."""
    problem = make_problem()
    made = simulate(Experiment(problem, {"exact": NamedEstimator("point-mass")}, runs=600, seed=9), 0, 600)
    measurement = made.measurement[:, 0].copy()
    measurement[:, 1:] = np.nan
    return problem, made.truth[:, 0], measurement


def updated(name: str, world: Any, **options: Any) -> tuple[Any, Any]:
    problem, truth, measurement = world
    estimator = build(name, problem, **options)
    rngs = streams(9, "estimator", range(len(truth)))
    return estimator, estimator.update(estimator.init(problem.prior, rngs), measurement, rngs)


@pytest.mark.parametrize("name", BUILT_IN)
def test_ranks_acquit_exact_filters_where_pit_does_not(name, world):
    """After one beam the belief is a half ring: ranks are flat (p > 0.001), the Gaussian claim is not.

    Three histograms for two filters: an exact belief fails 6 seeds in 1000.
    """
    truth = world[1]
    estimator, belief = updated(name, world, **BUILT_IN[name])
    found = judged(estimator, belief, truth, 9, range(len(truth)))
    for ranks in (*found.ranks.T, found.distance_rank):
        assert uniform_p_value(rank_histogram(ranks)) > 1e-3
    mean, covariance, _ = estimator.estimate(belief)
    claimed = pit(truth[:, 0] - mean[:, 0], np.sqrt(covariance[:, 0, 0]))
    assert uniform_p_value(histogram(claimed)) < 1e-9


@dataclass(frozen=True)
class Scaled:
    """Draws drawn together or spread about their mean: covariance times `scale`, shape as it was."""

    exact: Any
    scale: float

    def sample(self, belief: Any, size: int, rngs: Any) -> np.ndarray:
        mean = self.exact.estimate(belief).mean[:, None]
        return np.asarray(mean + np.sqrt(self.scale) * (self.exact.sample(belief, size, rngs) - mean))


@pytest.mark.parametrize(("scale", "ends"), [(0.5, (2.0, np.inf)), (2.0, (0.0, 0.6))])
def test_scaled_covariances_bend_the_rank_histogram(scale, ends, world):
    """Half the covariance: a U, ends above the middle. Twice: a dome, ends below it. p < 1e-6 for both."""
    truth = world[1]
    exact, belief = updated("point-mass", world, cell=0.04)
    found = judged(Scaled(exact, scale), belief, truth, 9, range(len(truth)))
    counts = sum(rank_histogram(ranks) for ranks in found.ranks.T)
    assert uniform_p_value(counts) < 1e-6
    ratio = counts[[0, -1]].mean() / counts[3:7].mean()
    assert ends[0] < ratio < ends[1]


def test_a_gaussian_filter_s_belief_scores_as_its_claim_does(world):
    """What an EKF samples is what it claims: the scores agree within 4 standard errors; its ranks are a U."""
    truth = world[1]
    estimator, belief = updated("ekf", world)
    found = judged(estimator, belief, truth, 9, range(len(truth)))
    mean, covariance, _ = estimator.estimate(belief)
    gap = found.energy - energy_score(truth - mean, covariance)
    assert abs(gap.mean()) < 4 * gap.std() / np.sqrt(len(gap))
    counts = rank_histogram(found.ranks[:, 0])
    assert counts[[0, -1]].mean() > 2 * counts[3:7].mean()


def test_better_beliefs_score_better(world):
    """The exact belief has lower energy and CRPS than its own Gaussian, by over 4 standard errors."""
    truth = world[1]
    estimator, belief = updated("point-mass", world, cell=0.04)
    found = judged(estimator, belief, truth, 9, range(len(truth)))
    mean, covariance, _ = estimator.estimate(belief)
    stds = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    gains = [
        energy_score(truth - mean, covariance) - found.energy,
        crps(truth - mean, stds)[:, 1] - found.crps[:, 1],
    ]
    for gain in gains:
        assert gain.mean() > 4 * gain.std() / np.sqrt(len(gain))


def test_ranks_come_from_a_study_to_rows_summary_and_figure(tmp_path):
    """`beliefs` in studies of a filter that samples, one that does not, and one that is told less noise.

    An exact filter has p < 0.001 for 1 seed in 1000, and more than 3 of 30 bars outside for 1 in 10 000.
    """
    sure = make_problem(0.01)  # told a fifth of the noise
    estimators = {"exact": NamedEstimator("point-mass", {"cell": 0.1}), "prior": PriorOnly}
    experiment = Experiment(make_problem(), estimators, runs=200, beliefs=True, beam_sets=[[2]])
    results = run(experiment, tmp_path / "one", timing=False)
    exact, prior = summarise(results)
    assert prior.beliefs is None
    assert exact.beliefs is not None
    assert exact.beliefs.ranks.sum(1).tolist() == [200.0] * 3
    columns = exact.flat()
    assert columns["belief_energy_score"] == exact.beliefs.energy.value
    assert columns["energy_score"] == exact.scores.energy.value
    assert columns["belief_rank_p_x1"] > 1e-3
    header, first, second = (tmp_path / "one" / "summary.csv").read_text().splitlines()
    assert set(columns) == set(header.split(","))
    assert second.split(",")[header.split(",").index("belief_crps_x2")] == "nan"
    assert first.count("nan") < second.count("nan")
    told = Experiment(make_problem(), {"sure": NamedEstimator("ekf")}, runs=200, beliefs=True, assumed=sure)
    wrong_results = run(told, timing=False)
    wrong = summarise(wrong_results)
    assert wrong[0].flat()["belief_rank_p_x2"] < 1e-6
    data = FigureData(results)
    assert data.has_samples()
    figure = plot_ranks(results).figure
    assert len(figure.axes) == 3
    bars = [bar.get_facecolor() for axes in figure.axes for bar in axes.patches[:10]]
    assert bars.count(to_rgba(CLAIMED)) >= 27
    odd = plot_ranks(wrong_results).figure
    assert to_rgba(OUTSIDE["facecolor"]) in [bar.get_facecolor() for bar in odd.axes[1].patches]
    assert not FigureData(replace(results, estimators=("prior",))).has_samples()
