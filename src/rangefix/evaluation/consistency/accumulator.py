"""The row of one estimator, from runs that come in chunks: three passes, and no more memory than a chunk."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from ...arrays import Array, BoolArray
from ..results import BeliefScores
from .belief_scores import rank_histogram
from .intervals import LEVEL, UNKNOWN, Interval, Moments, can_divide, share_interval
from .normalised import anees_band, is_positive, nees
from .row import BeliefSummary, ClaimScores, Row
from .scores import BINS, crps, energy_score, log_score_of

PLACE = ("x1", "x2")  # whose claim the energy score judges
LEVELS = (0.5, 0.9, 0.99)  # of the ellipses whose coverage is counted
PASSES = 3  # over the runs: means; what varies about the means; what varies about G


class RunBlock:
    """Some runs that went well: errors (M, n), claimed covariances (M, n, n), and their NEES (M,).

    Where they are known, also log evidence (M,) and what draws from the beliefs come to.
    """

    def __init__(
        self,
        errors: Array,
        covariance: Array,
        log_evidence: Array | None = None,
        belief: BeliefScores | None = None,
    ) -> None:
        self.errors, self.covariance, self.belief = errors, covariance, belief
        self.log_evidence = np.full(len(errors), np.nan) if log_evidence is None else log_evidence

    @cached_property
    def positive(self) -> BoolArray:
        """Which covariances are positive definite."""
        return is_positive(self.covariance)

    @cached_property
    def nees(self) -> Array:
        """Normalised estimation errors squared."""
        return nees(self.errors, self.covariance)


class Accumulator:
    """What all runs of one estimator come to; each chunk is added in each pass, in the same order."""

    def __init__(self, names: tuple[str, ...]) -> None:
        size = len(names)
        self.names, self.size, self.runs, self.indefinite = names, size, 0, 0
        self.place = [names.index(name) for name in PLACE] if set(PLACE) <= set(names) else []
        self.log_score, self.energy, self.evidence = Moments(), Moments(), Moments()
        self.crps, self.beliefs = [Moments() for _ in range(size)], BeliefTotals(size)
        self.G, self.P = np.zeros((size, size)), np.zeros((size, size))
        self.g, self.p, self.bias, self.ratio = ([Moments() for _ in range(size)] for _ in range(4))
        self.anees, self.logs = Moments(), (Moments(), Moments())
        self.inside = dict.fromkeys(LEVELS, 0)
        self.slopes = np.zeros((2, size, size))
        self.inverse: Array | None = None
        self.infinite = False

    def add_all(self, chunks: list[RunBlock]) -> None:
        """All passes over chunks that are at hand."""
        for number in range(PASSES):
            for chunk in chunks:
                self.add(number, chunk)
            self.end(number)

    def add(self, number: int, chunk: RunBlock) -> None:
        """Add a chunk in a pass, 0, 1 or 2."""
        if len(chunk.errors):
            (self._means, self._variations, self._indices)[number](chunk)
            if number == 0:
                self._scores(chunk)

    def end(self, number: int) -> None:
        """Close a pass."""
        if number == 0 and self.runs:
            self.G, self.P = self.G / self.runs, self.P / self.runs
            if self.runs > 1 and is_positive(self.G):
                self.inverse = np.asarray(np.linalg.inv(self.G), dtype=float)
        elif number == 1 and self.runs:
            self.slopes = self.slopes / self.runs

    def _means(self, chunk: RunBlock) -> None:
        errors, covariance = chunk.errors, chunk.covariance
        self.runs += len(errors)
        self.G = self.G + errors.T @ errors
        self.P = self.P + covariance.sum(0)
        for i in range(self.size):
            self.g[i].add(errors[:, i] ** 2)
            self.p[i].add(covariance[:, i, i])
            self.bias[i].add(errors[:, i])
        self.anees.add(chunk.nees / self.size)
        self.indefinite += int((~chunk.positive).sum())
        for level in LEVELS:
            self.inside[level] += int((chunk.nees <= chdtri(self.size, 1 - level)).sum())

    def _scores(self, chunk: RunBlock) -> None:
        errors, covariance = chunk.errors, chunk.covariance
        self.log_score.add(log_score_of(chunk.nees, covariance, chunk.positive))
        self.evidence.add(chunk.log_evidence)
        if self.place:
            plane = covariance[:, self.place][:, :, self.place]
            self.energy.add(energy_score(errors[:, self.place], plane))
        stds = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        for moments, each in zip(self.crps, crps(errors, stds).T, strict=True):
            moments.add(each)
        if chunk.belief is not None:
            self.beliefs.add(chunk.belief)

    def _variations(self, chunk: RunBlock) -> None:
        for i, (g, p) in enumerate(zip(self.g, self.p, strict=True)):
            if can_divide(g, p):
                squares, claims = chunk.errors[:, i] ** 2, chunk.covariance[:, i, i]
                self.ratio[i].add((squares - g.mean / p.mean * claims) / p.mean)
        if self.inverse is None:
            return
        whitened = chunk.errors @ self.inverse
        true, logs = self._logs(chunk, whitened)
        apart = true > 0
        for k, signs in enumerate((np.sign(logs), np.ones(len(logs)))):
            weights = np.where(apart, signs / np.where(apart, true, 1.0), 0.0) / np.log(10.0)
            self.slopes[k] += whitened.T @ (whitened * weights[:, None])

    def _indices(self, chunk: RunBlock) -> None:
        if self.inverse is None:
            return
        errors = chunk.errors
        _, logs = self._logs(chunk, errors @ self.inverse)
        if not np.isfinite(logs).all():
            self.infinite = True
            return
        both = np.sign(logs), np.ones(len(logs))
        for moments, slope, signs in zip(self.logs, self.slopes, both, strict=True):
            influence = ((errors @ slope) * errors).sum(-1) - float((slope * self.G).sum())
            moments.add(10.0 * (signs * logs + influence))

    def _logs(self, chunk: RunBlock, whitened: Array) -> tuple[Array, Array]:
        """Squared errors e' G^-1 e, and log10 of e' P^-1 e over it; 0 where there is no error."""
        true = (whitened * chunk.errors).sum(-1)
        apart = true > 0
        with np.errstate(divide="ignore"):
            ratios = np.where(apart, chunk.nees, 1.0) / np.where(apart, true, 1.0)
            return true, np.where(apart, np.log10(ratios), 0.0)

    def noncredibility(self, level: float = LEVEL) -> tuple[Interval, Interval]:
        """NCI and inclination, dB."""
        if self.inverse is None:
            return UNKNOWN, UNKNOWN
        if self.infinite:
            worst = Interval(np.inf, np.nan, np.inf)
            return worst, worst
        index, inclination = self.logs
        return index.interval(level), inclination.interval(level)

    def ratios(self) -> tuple[Interval, ...]:
        """G_ii / P_ii."""
        return tuple(
            varied.around(g.mean / p.mean, bound=0.0) if can_divide(g, p) else UNKNOWN
            for g, p, varied in zip(self.g, self.p, self.ratio, strict=True)
        )

    def p_values(self) -> dict[str, float]:
        """p-values of what an honest estimator fixes: anees, ratio_NAME, bias_NAME; NaN = cannot say."""
        found = {"anees": self.anees.p_value_of_mean(1.0)}
        for name, g, p, ratio, bias in zip(self.names, self.g, self.p, self.ratio, self.bias, strict=True):
            if can_divide(g, p):
                found[f"ratio_{name}"] = ratio.p_value(g.mean / p.mean, 1.0)
            found[f"bias_{name}"] = bias.p_value_of_mean(0.0)
        return found

    def row(
        self,
        *,
        planned: int,
        failures: dict[str, int],
        improbable: int = 0,
        estimator: str = "",
        beams: str = "",
        step: int = 0,
        seconds: float = np.nan,
        one_truth: bool = False,
    ) -> Row:
        """The row after all passes, of the runs that went well out of those planned."""
        unknown = np.full((self.size, self.size), np.nan)
        index, inclination = self.noncredibility()
        return Row(
            estimator=estimator,
            beams=beams,
            step=step,
            names=self.names,
            planned=planned,
            ok=self.runs,
            failures=failures,
            G=self.G if self.runs else unknown,
            P=self.P if self.runs else unknown,
            g=tuple(moments.interval() for moments in self.g),
            p=tuple(moments.interval() for moments in self.p),
            ratio=self.ratios(),
            bias=tuple(moments.interval() for moments in self.bias),
            anees=self.anees.interval(),
            anees_band=anees_band(self.runs, self.size),
            nci=index,
            inclination=inclination,
            coverage={level: share_interval(hits, self.runs) for level, hits in self.inside.items()},
            indefinite=share_interval(self.indefinite, self.runs),
            diverged=share_interval(failures.get("diverged", 0), planned),
            improbable=share_interval(improbable, self.runs),
            scores=ClaimScores(
                self.log_score.interval(),
                self.energy.interval(),
                tuple(moments.interval() for moments in self.crps),
                self.evidence.interval(),
            ),
            seconds=seconds,
            p_values=self.p_values(),
            one_truth=one_truth,
            beliefs=self.beliefs.summary(),
        )


class BeliefTotals:
    """What the beliefs of all runs come to; chunk by chunk, in the same order, the same numbers."""

    def __init__(self, size: int) -> None:
        self.counts = np.zeros((size + 1, BINS))
        self.energy, self.share = Moments(), Moments()
        self.crps, self.whole, self.mode = ([Moments() for _ in range(size)] for _ in range(3))

    def add(self, found: BeliefScores) -> None:
        """Take in the runs of a chunk, but for those whose beliefs were not sampled."""
        known = np.isfinite(found.energy)
        ranks, distance, energy, crps, share, mode, whole = (array[known] for array in found)
        for counts, each in zip(self.counts, [*ranks.T, distance], strict=True):
            counts += rank_histogram(each)
        self.energy.add(energy)
        self.share.add(share)
        for i, (score, all_draws, main) in enumerate(zip(self.crps, self.whole, self.mode, strict=True)):
            score.add(crps[:, i])
            all_draws.add(whole[:, i, i])
            main.add(mode[:, i, i])

    def summary(self) -> BeliefSummary | None:
        """What they come to; None where no belief was sampled."""
        if not self.energy.count:
            return None
        return BeliefSummary(
            energy=self.energy.interval(),
            crps=_intervals(self.crps),
            whole=_intervals(self.whole),
            mode=_intervals(self.mode),
            share=self.share.interval(),
            ranks=self.counts,
        )


def _intervals(moments: Iterable[Moments]) -> tuple[Interval, ...]:
    return tuple(each.interval() for each in moments)
