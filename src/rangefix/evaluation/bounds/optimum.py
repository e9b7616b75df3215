"""The covariance of the best estimate that there is, by integration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...arrays import Array, BoolArray
from ...filters.estimate import Estimate
from ...filters.exact import ExactPositionFilter
from ...filters.problem import Problem
from ...filters.refined_cells.filter import RefinedBelief, RefinedPointMassFilter
from ...filters.registry import build
from .averages.draws import SEED, SETS, place_moments, set_means
from .averages.reading_grid import expected_covariance
from .averages.sampled_poses import SampledPoses
from .bound import Bound, NoBoundError, require_full_weight, require_static

DRAWS_OF_EXACT, DRAWS_OF_LATTICES = 8192, 512
DRAWS_OF_SAMPLES = 1024, 4096  # the second where the first leave more than this share open
ACCURATE_SHARE_OF_SAMPLES = 0.01
FEW_SAMPLES, MOST_SAMPLES = 2**17, 2**21  # of the prior, over which posteriors are weighed
MOST_RANGES = 2**23  # of all of them: of many beams there are fewer samples
ENOUGH_SHARE, MOST_SHARE = 1e-3, 0.04  # mean of 1 / effective number: aimed at, and borne
DRAWS_OF_POSES = 64, 256  # on lattices; the second where the first leave more than ACCURATE_SHARE open
ACCURATE_SHARE = 0.03
CHECKED = 4  # one in so many poses is found on another lattice too, which tells the error
MIN_BEAMS_OF_POSES = 3  # posteriors of fewer fill the room, and take seconds each on a lattice
DIRECTION_ERRORS = 4.0  # standard errors of the samples that a mean direction has at the least: less is none
MAX_ERROR = 0.1  # deviations; of a heading without a mean none is known
ACCURACY = 0.005  # asked of lattices, in deviations of the posterior
ACCURACY_OF_POSES = 0.1  # the same; what it errs by is in the error, and averages out
MAX_COMPONENTS = 3
Answer = Callable[[Array, Array], Array]  # what is averaged, of truths (N, n) and readings (N, B)
CIRCULAR = (
    "heading: mean square of the wrapped error e of the circular mean, which is the best estimate for "
    "E[2 - 2 cos e], and not always for e squared"
)


def optimum(problem: Problem) -> Bound:
    """G of the conditional mean: E[P] over truths and readings, P the covariance of the exact posterior.

    Of one or two beams with Gaussian noise at a known heading by a sum over readings; else an average over
    truths and readings (Rao-Blackwell: of P, not of squared errors), with its standard error. At an unknown
    heading posteriors are over samples of the prior where enough of these count, else on lattices. It is no
    bound, but what bounds are below. Of a heading it is the mean square of the wrapped error of the circular
    mean.

    Raises:
        NoBoundError: If the object moves, readings weigh less than their law says, the state has more than
            three components, or the heading is unknown and there are fewer than three beams, too accurate for
            samples of all poses.
    """
    check_static(problem)
    require_full_weight(problem)
    unknown_heading = bool(problem.space.is_angle.any())
    measured = int((~problem.sensor.blind).sum())
    if unknown_heading:
        if (sampled := _of_samples(problem)) is not None:
            return sampled
        if measured < MIN_BEAMS_OF_POSES:
            raise NoBoundError(
                f"the readings are too accurate for {MOST_SAMPLES} samples of all places and headings, and "
                f"what fewer than {MIN_BEAMS_OF_POSES} beams leave of these is too much for a lattice"
            )
    estimator: Any = (
        RefinedPointMassFilter(problem, ACCURACY_OF_POSES)
        if unknown_heading
        else build("adaptive-point-mass", problem, accuracy=ACCURACY)
    )
    exact = isinstance(estimator, ExactPositionFilter)
    if exact and (summed := expected_covariance(estimator)) is not None:
        return Bound("optimum", *summed, ("summed over readings",))

    counts = (DRAWS_OF_EXACT,) if exact else DRAWS_OF_POSES if unknown_heading else (DRAWS_OF_LATTICES,)
    count, sums, matrix, error = _averaged(
        problem, counts, ACCURATE_SHARE, lambda count: _posteriors(problem, estimator, count // SETS)
    )
    told: tuple[str, ...] = (f"averaged over {count} truths and readings",)
    if unknown_heading:
        told += (CIRCULAR,)
    if share := float(sums[:, 2].mean(axis=0).max()):
        told += (
            f"the filter's own error is not known for {100 * share:.0f} % of readings, and not in the error",
        )
    return Bound("optimum", matrix, error + sums[:, 1].mean(axis=0), told)


def _of_samples(problem: Problem) -> Bound | None:
    """The same by posteriors over samples of the prior; None where most of these would weigh nothing."""
    samples = FEW_SAMPLES
    share = float(set_means(problem, SETS, _over_samples(problem, samples))[:, 1].mean(axis=0).max())
    if share > ENOUGH_SHARE:
        most = min(MOST_SAMPLES, 2 ** int(np.log2(MOST_RANGES / len(problem.sensor.bearings))))
        samples = int(min(most, samples * 2 ** np.ceil(np.log2(share / ENOUGH_SHARE))))
    if share * FEW_SAMPLES / samples > MOST_SHARE:
        return None
    answer = _over_samples(problem, samples)
    count, sums, matrix, error = _averaged(
        problem, DRAWS_OF_SAMPLES, ACCURATE_SHARE_OF_SAMPLES, lambda _: answer
    )
    share = float(sums[:, 1].mean(axis=0).max())
    if share > MOST_SHARE:
        return None
    told: tuple[str, ...] = (
        f"averaged over {count} truths and readings; posteriors over {samples} samples of the prior, worth "
        f"{1 / share:.0f} of equal weight",
        CIRCULAR,
    )
    if lost := float(sums[:, 2].mean(axis=0).max()):
        told += (
            f"the heading has no circular mean for {100 * lost:.0f} % of readings: its entry is of an "
            "arbitrary direction there",
        )
    return Bound("optimum", matrix, error + share * np.abs(matrix), told)


def _over_samples(problem: Problem, samples: int) -> Answer:
    """What is averaged over truths and readings, as of `_posteriors` but for the second and third.

    These are 1 / effective number of the samples, and whether the heading has no circular mean.
    """
    poses = SampledPoses.of(problem, samples, np.random.default_rng([SEED, samples]))
    moments = place_moments(problem)

    def answer(_: Array, readings: Array) -> Array:
        found = poses.posteriors(readings)
        shares = 1 / np.maximum(found.effective, 1.0)
        undirected = found.direction < DIRECTION_ERRORS * np.sqrt(shares)
        covariance = np.where((found.effective > 0)[:, None, None], found.covariance, 0.0)
        mean = np.where((found.effective > 0)[:, None], found.mean, np.asarray(problem.prior.mean))
        told = (_filled(values, covariance) for values in (shares, undirected))
        return _parts(problem, moments, mean, covariance, *told)

    return answer


def _posteriors(problem: Problem, estimator: Any, size: int) -> Answer:
    """What is averaged over truths and readings: of each, matrices in this order.

    P; how far it may be off; whether that is not known; P plus the square of how far the posterior's mean
    lies from the prior's; the product of that and P; its square.
    """
    exact = isinstance(estimator, ExactPositionFilter)
    checked = -(-size // CHECKED)  # of poses; the others err alike
    moments = place_moments(problem)

    def answer(states: Array, readings: Array) -> Array:
        rngs = [np.random.default_rng([0, run]) for run in range(len(readings))]
        belief = estimator.update(estimator.init(problem.prior, rngs), readings, rngs)
        mean, covariance, _ = (np.asarray(part) for part in estimator.estimate(belief))
        off = np.zeros(len(states))
        if not exact:
            some = _first(belief, checked) if isinstance(belief, RefinedBelief) else belief
            off = np.resize(estimator.error(some), len(states))
        unknown = ~(off <= MAX_ERROR)
        stds = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        wrong = np.where(unknown, 0.0, off)[:, None, None] * stds[:, :, None] * stds[:, None, :]
        return _parts(problem, moments, mean, covariance, wrong, _filled(unknown, covariance))

    return answer


def _parts(problem: Problem, moments: tuple[Array, Array] | None, mean: Array, *averaged: Array) -> Array:
    """What is averaged, (N, 6, n, n): three matrices, P first, and what `_with_control` takes off."""
    covariance = averaged[0]
    spread = np.zeros_like(covariance)
    if moments is not None:
        places = problem.space.position_indices
        where = np.ix_(range(len(mean)), places, places)
        away = mean[:, places] - moments[0]
        spread[where] = covariance[where] + away[:, :, None] * away[:, None, :]
    return np.stack([*averaged, spread, covariance * spread, spread**2], axis=1)


def _filled(values: Array | BoolArray, like: Array) -> Array:
    """A value of each draw, as matrices."""
    return np.broadcast_to(np.asarray(values, dtype=float)[:, None, None], like.shape)


def _first(belief: RefinedBelief, count: int) -> RefinedBelief:
    """The first runs of a belief."""
    estimate = Estimate(*(np.asarray(part)[:count] for part in belief.estimate))
    return RefinedBelief(belief.readings[:count], estimate, belief.error[:count], belief.far[:count])


def _averaged(
    problem: Problem, counts: Sequence[int], enough: float, answer: Callable[[int], Answer]
) -> tuple[int, Array, Array, Array]:
    """Averages over one number of draws after the other, until the error of E[P] is a small share of it.

    Returns:
        How many draws; the averages of sets of them, (SETS, 6, n, n); E[P] and its standard error, (n, n).
    """
    for count in counts:
        sums = set_means(problem, count, answer(count))
        matrix, error = _with_control(problem, sums)
        if (np.diagonal(error) <= enough * np.diagonal(matrix)).all():
            break
    return count, sums, matrix, error


def _with_control(problem: Problem, sums: Array) -> tuple[Array, Array]:
    """E[P] and its standard error, from the averages of independent sets, (SETS, 6, n, n).

    By the law of total variance P plus the square of the posterior mean's deviation averages to the spread of
    the prior, which is known: what the draws have of it by chance is taken off P as far as the two go
    together (a control variate; Owen, Monte Carlo theory, 2013, section 8.9).
    """
    covariance, spread = sums[:, 0], sums[:, 3]
    moments = place_moments(problem)
    if moments is not None:
        p, _, _, z, product, square = (np.diagonal(part) for part in sums.mean(axis=0))
        variance = square - z**2
        together = np.divide(product - p * z, variance, out=np.zeros_like(p), where=variance > 0)
        root = np.sqrt(np.clip(together, 0.0, 1.0))
        known = np.zeros_like(covariance[0])
        known[np.ix_(problem.space.position_indices, problem.space.position_indices)] = moments[1]
        covariance = covariance - root[:, None] * (spread - known) * root
    return covariance.mean(axis=0), covariance.std(axis=0, ddof=1) / np.sqrt(SETS)


def check_static(problem: Problem) -> None:
    """Refuse what moves or has many components.

    Raises:
        NoBoundError: If it does.
    """
    require_static(problem)
    if problem.space.size > MAX_COMPONENTS:
        raise NoBoundError(f"computed here for up to {MAX_COMPONENTS} components of the state")
