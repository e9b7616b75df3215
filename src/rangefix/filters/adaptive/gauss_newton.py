"""From many guesses to the modes near them: trimmed Gauss-Newton steps, all guesses at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ..models.wrapped_noise import reading_spread
from .target import BATCH, CAP, Target

QUICK_BEAMS = 64  # that a first look uses
MAX_GUESSES = 100  # that are followed with every beam, where there are more beams
STEPS = 8
FITTED_SHARE = 0.7  # of the beams: each step fits at least so many
LAST_STEP_SQUARED = 1e-3  # squared length, in standard deviations, of steps that are the last
SETTLED_SHARE = 0.9  # of the guesses: of so many must it be the last


class Peaks(NamedTuple):
    """Where guesses ended.

    Attributes:
        states: (K, n).
        log_density: Theirs under the target, (K,).
        score: The same with no beam counting for more than CAP nats below a perfect fit, (K,).
        information: Inverse covariance of a Gaussian there, (K, n, n).
    """

    states: Array
    log_density: Array
    score: Array
    information: Array


def quick_scores(
    target: Target, states: Array, log_prior: Array | None = None, beams: int = QUICK_BEAMS
) -> Array:
    """Scores of states by a few beams spread over the scan.

    Args:
        target: The posterior.
        states: (K, n).
        log_prior: Log prior of the states, (K,), if it is known.
        beams: How many.

    Returns:
        As in `Peaks`, (K,).
    """
    few = target.few(beams)
    logs = target.log_prior(states) if log_prior is None else log_prior
    parts = np.array_split(np.arange(len(states)), 1 + len(states) * beams // BATCH)
    return np.concatenate([_scores(few, few.expected(states[part]), logs[part]) for part in parts])


def climb(
    target: Target, states: Array, mean: Array, precision: Array, steps: int = STEPS, trimmed: bool = True
) -> Peaks:
    """Trimmed Gauss-Newton steps towards the target's modes.

    With many beams a few of them go ahead, and the best guesses follow with all.

    Args:
        target: The posterior.
        states: Guesses, (K, n).
        mean: A Gaussian that stands for the prior near each guess: its mean, (n,) or (K, n),
        precision: and inverse covariance, (n, n) or (K, n, n).
        steps: How many at most; with none the guesses are taken as they are.
        trimmed: Whether a step fits only the beams that fit well; else it fits all.

    Returns:
        The best state met on each way, by score; of steps that fit all beams, the last one.
    """
    mean = np.broadcast_to(mean, states.shape)
    precision = np.broadcast_to(precision, (*states.shape, states.shape[1]))
    few = target.few(QUICK_BEAMS)
    if few is not target:
        ahead = _steps(few, states, mean, precision, steps, trimmed)
        best = np.argsort(-ahead.score, kind="stable")[:MAX_GUESSES]
        states, mean, precision = ahead.states[best], mean[best], precision[best]
    return _steps(target, states, mean, precision, steps, trimmed)


def _steps(target: Target, states: Array, mean: Array, precision: Array, steps: int, trimmed: bool) -> Peaks:
    space = target.sensor.space
    best, left = _look(target, states, mean, precision, trimmed)
    for _ in range(steps):
        information, pull, _ = left
        move = np.linalg.solve(information, pull[..., None])[..., 0]
        if ((move * pull).sum(axis=-1) < LAST_STEP_SQUARED).mean() > SETTLED_SHARE:
            break
        states = space.wrap(states + move)
        here, left = _look(target, states, mean, precision, trimmed)
        better = here.score > best.score if trimmed else np.ones(len(states), np.bool_)
        masks = (better.reshape(-1, *[1] * (new.ndim - 1)) for new in here)
        best = Peaks(*map(np.where, masks, here, best))
    return best


def box_scores(target: Target, states: Array, precision: Array) -> Array:
    """About how much of the posterior lies in boxes about states, as far as ranges are straight there.

    The best that a box holds may be many standard deviations from its middle. The log of the integral of a
    Gaussian box times the likelihood of a linear model, in which beams that do not fit cost CAP nats each.

    Args:
        target: The posterior.
        states: Middles of the boxes, (K, n).
        precision: Inverse covariance of the box, (n, n).

    Returns:
        Nats, up to a constant, (K,).
    """
    peaks, (information, pull, misfit) = _look(
        target, states, states, np.broadcast_to(precision, (*states.shape, states.shape[1]))
    )
    gained = (pull * np.linalg.solve(information, pull[..., None])[..., 0]).sum(axis=-1)
    prior = peaks.log_density > -np.inf
    scores = 0.5 * gained - misfit - 0.5 * np.linalg.slogdet(information)[1]
    return np.asarray(np.where(prior, scores, scores - CAP))


def _look(
    target: Target, states: Array, mean: Array, precision: Array, trimmed: bool = True
) -> tuple[Peaks, tuple[Array, Array, Array]]:
    """What the target is at states, and what a step is made of: information (K, n, n) and pull (K, n).

    And by how many nats the beams that are used are off, with CAP for each that is not, (K,).
    """
    sensor, measured, beams = target.sensor, ~np.isnan(target.measurements), target.beams
    (expected, slopes), prior = target.expected_and_slopes(states), target.log_prior(states)
    counts = measured.sum(axis=0)[beams]
    with np.errstate(over="ignore", invalid="ignore"):  # no return and too close in turn have no mean
        mean_reading = np.where(measured, target.measurements, 0.0).sum(axis=0)[beams] / counts
    mean_reading = mean_reading - target.bias
    usable = np.isfinite(mean_reading) & np.isfinite(expected[:, beams])
    spread = reading_spread(sensor.noise, np.where(np.isfinite(expected), expected, 1.0))
    scale = spread[:, beams] / np.sqrt(counts)
    with np.errstate(invalid="ignore"):
        deviates = np.where(usable, mean_reading - expected[:, beams], 0.0) / scale
    used = usable
    if trimmed:
        used = usable & (np.abs(deviates) <= _bars(np.abs(deviates), usable, states.shape[1])[:, None])
    slopes = np.where(used[..., None], slopes / scale[..., None], 0.0)
    information = np.swapaxes(slopes, 1, 2) @ slopes + precision
    back = sensor.space.difference(mean, states)
    pull = np.einsum("kbi,kb->ki", slopes, np.where(used, deviates, 0.0))
    pull = pull + (precision @ back[..., None])[..., 0]
    logs = prior + sum(sensor.log_density(reading, expected) for reading in target.measurements)
    lost = np.where(used, 0.5 * deviates**2, CAP).sum(axis=1)
    return Peaks(states, logs, _scores(target, expected, prior), information), (information, pull, lost)


def _bars(sizes: Array, usable: Array, components: int) -> Array:
    """How far off a beam may be and count: 3 standard deviations, or those of the share that must count.

    As many count as there are components, if there are: fewer leave a curve on which a step ends anywhere.
    """
    ordered, beams = np.sort(np.where(usable, sizes, np.inf), axis=1), usable.sum(axis=1)
    fitted = np.maximum((FITTED_SHARE * beams).astype(int), np.minimum(beams, components))
    place = np.maximum(fitted - 1, 0)
    return np.asarray(np.maximum(3.0, ordered[np.arange(len(sizes)), place]))


def _scores(target: Target, expected: Array, prior: Array) -> Array:
    """Log prior plus capped log likelihood, (K,); where the prior is zero, CAP nats below its greatest."""
    possible = prior > -np.inf
    total = np.where(possible, prior, prior.max(initial=-np.inf, where=possible) - CAP)
    for reading in target.measurements:
        perfect = target.sensor.beam_log_density(reading, np.fmax(reading - target.bias, 0.0))
        lost = perfect - target.sensor.beam_log_density(reading, expected)
        total = total - np.fmin(lost, CAP, out=lost).sum(-1)
    return np.asarray(total)
