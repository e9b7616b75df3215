"""Conformance: the answers themselves, against exact ones and against the truth.

Estimators that draw are judged by the scatter between their own runs, six standard errors of it; a sound one
fails any of these for fewer than 1 seed in 10 000, and the seeds are fixed. One that draws nothing is held to
a fiftieth of the posterior's own spread.
"""

from __future__ import annotations

from typing import Any
from unittest import SkipTest

import numpy as np

from ..estimate import Estimate
from ..problem import Problem
from .claims import SURE, CheckFailure, Subject, claim, deviations, need, need_agreement
from .problems import (
    CONTROL,
    answer,
    generators,
    kalman,
    moving_problem,
    pose_problem,
    position_problem,
    readings,
    repeated,
    settled,
    short_problem,
)

SEEDS = 32  # runs in which an estimator's own scatter is found
TRIALS = 150  # runs with truths of their own
BATCH = 30  # runs at once, for estimators that need much memory for each
ROUNDING_ALLOWED = 1e-5  # of the posterior's own spread
COARSE = 0.02  # the same, for a grid or another approximation without draws
FALSE_ALARM = 1e-6
RARE = 1e-3
LARGE = 4.0  # standard deviations
ANEES_ALLOWANCE = 1.15  # of ANEES, for the random error of an estimator's own draws
WRONG = 3.0  # m, added to every range of an impossible measurement
SURPRISE = 50.0  # nats
NAN = np.nan
BLIND_READINGS = (0.0, 1.0, np.inf, -np.inf, 1e300)
SAME = 1e-7  # m, m^2 and nats
ODD_READINGS = (0.0, -1.0, 20.0, 1e4, 1e9, 1e300, -1e300, np.inf)


@claim("Leave the terms of NaN readings out of the likelihood (sensor.log_density does); do not set them 0.")
def missing_beams_say_nothing(subject: Subject) -> None:
    """Readings with NaN in two of four beams give what a rangefinder with the other two beams gives."""
    problem, fewer = position_problem(), position_problem((0, 2))
    measurements = repeated(problem, SEEDS)
    gaps = [np.where(np.arange(4) % 2, NAN, measurement) for measurement in measurements]
    left = [measurement[:, ::2] for measurement in measurements]
    with_gaps = answer(subject.build(problem), problem, gaps, generators(SEEDS))
    without = answer(subject.build(fewer), fewer, left, generators(SEEDS))
    off = deviations(with_gaps, without, problem)
    need_agreement(off, ROUNDING_ALLOWED, 2, "a sensor without these beams")


@claim("Pair reading j with bearing j and noise j; do not sort, and do not assume that bearings ascend.")
def order_of_beams_does_not_matter(subject: Subject) -> None:
    """Beams, noise and readings in another order give the same answer."""
    order = (2, 0, 3, 1)
    problem, shuffled = position_problem(), position_problem(order)
    measurements = repeated(problem, SEEDS)
    plain = answer(subject.build(problem), problem, measurements, generators(SEEDS))
    others = [measurement[:, order] for measurement in measurements]
    mixed = answer(subject.build(shuffled), shuffled, others, generators(SEEDS))
    off = deviations(mixed, plain, problem)
    need_agreement(off, ROUNDING_ALLOWED, 2, "the answer with beams in another order")


@claim("Take circular means (space.moments) and wrapped differences (space.difference) of headings.")
def headings_are_angles(subject: Subject) -> None:
    """A problem turned by a half or a whole turn has the same answer, turned by as much.

    After a half turn the prior straddles the cut between pi and -pi.
    """
    still = pose_problem()
    measurements = repeated(still, SEEDS)
    reference = answer(subject.build_or_skip(still), still, measurements, generators(SEEDS))
    for name, turn in (("half", np.pi), ("whole", 2 * np.pi)):
        turned = pose_problem(turn)
        estimate = answer(subject.build(turned), turned, measurements, generators(SEEDS))
        differences = deviations(estimate, reference, still, turn)
        need_agreement(differences, ROUNDING_ALLOWED, 3, f"what it was before a {name} turn")


@claim(
    "Work in logs: subtract the greatest log weight before exp, and add the log of the sum to the log "
    "evidence. Where every weight is zero keep the moments from before and report -inf."
)
def impossible_measurement_is_flagged(subject: Subject) -> None:
    """Readings 3 m off leave finite moments and a log evidence 50 nats below a usual one's, or -inf.

    So do later usual readings. A beam without a return where there is a wall leaves finite moments, too. An
    estimator that does not compute a log evidence cannot flag: the check is then skipped.
    """
    problem = position_problem()
    estimator = subject.build(problem)
    _, (usual, later) = readings(problem, 5, 2)
    endless = usual.copy()
    endless[:, 0] = np.inf
    rngs = generators(5)
    belief = estimator.update(estimator.init(problem.prior, rngs), usual, rngs)
    normal = np.asarray(settled(estimator.estimate(estimator.update(belief, later, rngs)), 5).log_evidence)
    silent = bool(np.isnan(normal).all())
    for what, reading in (("readings 3 m off", later + WRONG), ("a beam without a return", endless)):
        after = estimator.update(belief, reading, rngs)
        again = estimator.update(estimator.predict(after, CONTROL.copy(), rngs), later, rngs)
        for when, state in ((f"after {what}", after), (f"after {what} and usual ones", again)):
            mean, covariance, log_evidence = settled(estimator.estimate(state), 5)
            need(np.isfinite(mean).all(), f"the mean is not finite {when}")
            need(np.isfinite(covariance).all(), f"the covariance is not finite {when}")
            need(np.isnan(log_evidence).sum() in (0, 5), f"the log evidence is NaN in some runs {when}")
            need(silent or not np.isnan(log_evidence).any(), f"the log evidence is NaN {when}")
            least = (normal - log_evidence).min()
            flagged = silent or reading is endless or least > SURPRISE
            need(flagged, f"the log evidence is only {least:.3g} nats below a usual one's {when}")
    if silent:
        raise SkipTest("does not compute a log evidence, so it cannot flag an impossible measurement")


@claim(
    "Begin update with `measurement = check_measurement(sensor, measurement, len(rngs))` of filters, "
    "or for single runs with `check_reading(sensor, measurement)`: what says nothing is then NaN. An inf is "
    "no range but no return: ask sensor.log_density, or leave it out."
)
def readings_mean_what_they_mean_to_all(subject: Subject) -> None:
    """Nothing is said by blind beams, -inf without a minimum range, and inf where no wall is in reach.

    Of every other reading, from a negative one to 1e300, finite moments are left. What is not of the shape
    (M, B), or does not hold real numbers, is refused by ValueError.
    """
    problem, runs = position_problem(blind=True), 2
    estimator, rngs = subject.build(problem), generators(runs)
    _, (usual,) = readings(problem, runs, 1)
    prior = estimator.init(problem.prior, rngs)

    def after(reading: float, beam: int) -> Estimate:
        changed = usual.copy()
        changed[:, beam] = reading
        with np.errstate(over="ignore", invalid="ignore"):
            return settled(estimator.estimate(estimator.update(prior, changed, generators(runs))), runs)

    def alike(one: Estimate, other: Estimate) -> bool:
        pairs = zip(one, other, strict=True)
        return all(np.allclose(a, b, rtol=0.0, atol=SAME, equal_nan=True) for a, b in pairs)

    for reading in BLIND_READINGS:
        need(alike(after(reading, -1), after(NAN, -1)), f"a blind beam that reads {reading:g} is believed")
    need(alike(after(-np.inf, 0), after(NAN, 0)), "-inf is not NaN, and there is no minimum range")
    short = short_problem()
    near, nothing = subject.build(short), np.full((runs, len(short.sensor.bearings)), np.inf)
    none, blank = (answer(near, short, [each], generators(runs)) for each in (nothing, NAN * nothing))
    off = deviations(none, blank, short)
    need_agreement(off, COARSE, 2, "what it is without readings where no wall is in reach and none returns")
    for reading in ODD_READINGS:
        mean, covariance, log_evidence = after(reading, 0)
        need(np.isfinite(mean).all(), f"the mean is not finite where a beam reads {reading:g}")
        need(np.isfinite(covariance).all(), f"the covariance is not finite where a beam reads {reading:g}")
        need(not np.isposinf(log_evidence).any(), f"the log evidence is inf where a beam reads {reading:g}")
    wrongs: tuple[tuple[str, Any], ...] = (
        ("a beam too few", usual[:, 1:]),
        ("a run too few", usual[1:]),
        ("complex numbers", usual + 0j),
        ("texts", usual.astype(str)),
    )
    for what, wrong in wrongs:
        try:
            estimator.update(prior, wrong, rngs)
        except ValueError:
            continue
        except Exception as error:
            raise CheckFailure(f"{what} gave {type(error).__name__}, not ValueError: {error}") from error
        raise CheckFailure(f"{what} were taken")


@claim(
    "Compare with the equations: innovation = reading - expected, gain = P H' (H P H' + R)^-1. If the random "
    "error is too large, take more particles by default; if P alone is off, look at its scale."
)
def agrees_with_the_kalman_filter(subject: Subject) -> None:
    """Where all is linear and Gaussian the answer is the Kalman filter's, log evidence included."""
    _need_kalman(subject, position_problem())


@claim(
    "Let predict use the control of each run, take P to F P F' with F = motion.jacobian, and add the "
    "motion's noise once; take ranges and slopes from the sensor, which stands off the object's centre."
)
def moves_like_the_kalman_filter(subject: Subject) -> None:
    """The same for an object that moves by its place and a control, with noise, its laser off its centre."""
    problem = moving_problem()
    subject.build_or_skip(problem)
    _need_kalman(subject, problem)


def _need_kalman(subject: Subject, problem: Problem) -> None:
    """Fail the check unless the answers, over seeds, are the Kalman filter's."""
    measurements = repeated(problem, SEEDS)
    measurements[1][:, 1] = NAN
    exact = kalman(problem, [measurement[0] for measurement in measurements])
    estimate = answer(subject.build(problem), problem, measurements, generators(SEEDS))
    differences = deviations(estimate, exact, problem)
    # averages over few particles are biased by about the square of their random error
    scatter = float(differences[:, :2].std(0, ddof=1).max())
    need_agreement(differences, COARSE + 2 * scatter**2, 2, "the Kalman filter's")


@claim(
    "Overconfident (above 1): noise too small, a reading counted twice, too few particles. Too cautious "
    "(below 1): P inflated. Biased: look at the sign of reading - expected."
)
def claims_what_is_true(subject: Subject) -> None:
    """Over truths drawn from the prior, errors are as large as P says: ANEES / n is 1, and no bias.

    The band is that of chi-square with a false alarm in 10^6 seeds, widened by 15 % for an estimator's own
    draws: 0.57 to 1.67 for two components. A run counts up to the 99.9 % point of chi-square and no more: the
    rare run in which few particles reach the truth does not decide.
    """
    _need_consistent(subject, position_problem())


@claim("As for claims_what_is_true; and look at the derivative by the heading, and at wrapped differences.")
def claims_what_is_true_with_a_heading(subject: Subject) -> None:
    """The same when the heading is estimated too."""
    problem = pose_problem()
    subject.build_or_skip(problem)
    _need_consistent(subject, problem)


def _need_consistent(subject: Subject, problem: Problem) -> None:
    """Fail the check unless errors of TRIALS runs are what the covariances claim."""
    from scipy.special import chdtri

    truths, (measurement,) = readings(problem, TRIALS, 1)
    estimator, size = subject.build(problem), problem.space.size
    parts = []
    for start in range(0, TRIALS, BATCH):
        some = measurement[start : start + BATCH]
        parts.append(answer(estimator, problem, [some], generators(len(some), first=start)))
    covariance = np.concatenate([part.covariance for part in parts])
    errors = problem.space.difference(np.concatenate([part.mean for part in parts]), truths)
    singular = ~(np.linalg.eigvalsh(covariance)[:, 0] > 0)  # all particles copies of one
    covariance[singular] = np.eye(size)
    scaled = np.linalg.solve(np.linalg.cholesky(covariance), errors[..., None])[..., 0]
    squares = np.minimum(np.where(singular, np.inf, (scaled**2).sum(1)), chdtri(size, RARE))
    anees = float(squares.mean() / size)
    freedom = TRIALS * size
    low = float(chdtri(freedom, 1 - FALSE_ALARM / 2)) / freedom / ANEES_ALLOWANCE
    high = float(chdtri(freedom, FALSE_ALARM / 2)) / freedom * ANEES_ALLOWANCE
    need(low <= anees <= high, f"ANEES / n is {anees:.3g}, sound is {low:.2f} to {high:.2f}")
    bias = float(np.abs(np.clip(scaled, -LARGE, LARGE).mean(0)).max())
    most = SURE / np.sqrt(TRIALS)
    need(bias <= most, f"errors average {bias:.2f} claimed standard deviations, sound is below {most:.2f}")
