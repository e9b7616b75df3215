"""Which cells of a prior a run's readings ask for, and what they come to.

Coarse cells that can hold the readings are integrated with the ranges of one wall for each beam. Where a
jump, a bend or the prior's end crosses a cell that may hold more than is allowed to err, it is halved along
every axis, with ranges cast anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ..problem import Problem
from ..space import StateSpace
from .box_model import NODES
from .coarse_cells import CoarseCells, models_at
from .denser_boxes import AMISS_NATS, SEARCH_NATS, denser_boxes, most_in_cells
from .halving import BENT_SCALES, Halving
from .likelihood import IMPOSSIBLE_NATS, Likelihood
from .pool import Pool, weighted_moments
from .quadrature import boxes_of, integrate, nodes
from .range_model import (
    QUADRATIC_NATS,
    PriorModel,
    RangeModel,
    bends,
    corner_reach,
    corners,
    prior_model,
    quadratic,
)

REST_SHARE = 1e-6  # of a belief: what all cells that were not looked at may hold
WORTH_HALVING = 1e-3  # of the worst cell's error: the others may prove to hold less
DROPPED_SHARE = 1e-9  # of a belief: cells that hold less are left out
LOOKED_AT_SHARE = 1e-5  # of a belief: in cells that hold less nothing is looked for between their corners
JUMP_SHARE = {2: 0.1, 3: 0.01}  # of the greatest mass of cells that jumps cross: the least they may err by
MOST_DISPLACED = 0.3  # the same, of a single cell
CALM_SHARE = 0.5  # of the accuracy: what cells that are halved no more may err by together
RULE_ERROR = 2e-3  # of mean and covariance, in deviations: what rules of three nodes may err by
BENDS_DISPLACE = 0.5  # of what ranges are off their models in whole cells, in deviations of the noise
HALVED_AT_ONCE = 4000  # cells of a run in one round, those that may err most
MAX_ROUNDS = 40
NEGLIGIBLE_SHARE = 1e-7  # of a belief: cells that may err by less are not halved
LEFT_SHARE = 0.5  # of what is allowed: what cells that are not halved in a round may err by
UNSEEN_NATS = 20.0  # by which a cell may be likelier than was thought where something was not seen in it
MOST_NATS = 400.0  # above a belief's mass that a cell is said to hold: times MOST_COUNTED it is a number
MOST_COUNTED = 1e100  # times its mass that a cell counts, of a belief that is all but a point
CUT_NODES = 4  # along each axis of a cell in which the prior ends


@dataclass(frozen=True)
class Refined:
    """What the cells of some runs come to.

    Attributes:
        mean: (M, n).
        covariance: (M, n, n).
        log_integral: Log of the integral of prior times likelihood, (M,).
        error: What jumps, bends and cells that are still wide may make mean and covariance err by, in
            deviations, (M,).
        pool: The cells.
    """

    mean: Array
    covariance: Array
    log_integral: Array
    error: Array
    pool: Pool

    def of_run(self, run: int) -> Refined:
        """One of the runs alone."""
        pool, chosen = self.pool.rows(self.pool.run == run), slice(run, run + 1)
        pool.run = np.zeros_like(pool.run)
        moments = self.mean[chosen], self.covariance[chosen]
        return Refined(*moments, self.log_integral[chosen], self.error[chosen], pool)

    def with_runs(self, runs: IntArray, theirs: Refined) -> Refined:
        """The same, written to, with some of its runs (R,) replaced by others' answers."""
        pool = replace(theirs.pool, run=runs[theirs.pool.run])
        kept = self.pool.rows(~np.isin(self.pool.run, runs))
        joined = replace(self, pool=Pool.joined([kept, pool]))
        for name in ("mean", "covariance", "log_integral", "error"):
            getattr(joined, name)[runs] = getattr(theirs, name)
        return joined


@dataclass(frozen=True)
class Refinement:
    """Cells for the readings of some runs.

    Attributes:
        problem: The problem.
        coarse: The coarse cells.
        accuracy: What mean and covariance may err by, in deviations.
        most_cells: The most cells of a run.
    """

    problem: Problem
    coarse: CoarseCells
    accuracy: float
    most_cells: int

    def answer(self, likelihood: Likelihood) -> Refined:
        """Mean, covariance and evidence of M runs."""
        bounds = most_in_cells(self.problem, self.coarse, likelihood)
        floor = bounds.max(axis=1) - SEARCH_NATS
        found = self._refined(likelihood, bounds, floor)
        lower = found.log_integral + np.log(REST_SHARE / np.exp(self.coarse.log_volumes).sum())
        lower = np.where(found.log_integral > -np.inf, lower, -np.inf)
        rest = np.where(bounds < floor[:, None], bounds, -np.inf).max(axis=1)
        again = np.flatnonzero((lower < floor) & (rest >= lower) & (rest > IMPOSSIBLE_NATS))
        if len(again):
            more = self._refined(likelihood.rows(again), bounds[again], lower[again])
            found = found.with_runs(again, more)
        wanted = likelihood.where_it_fits + self.coarse.prior.most.max() - AMISS_NATS
        for run in np.flatnonzero((found.log_integral < wanted) & (wanted > IMPOSSIBLE_NATS)):
            alone = np.array([run])
            closer = self._looked_closely(likelihood.rows(alone), bounds[alone], wanted[run])
            found = found if closer is None else found.with_runs(alone, closer)
        return found

    def boxes(self, likelihood: Likelihood, found: Refined) -> tuple[Array, Array, Array]:
        """One run's cells in boxes about the nodes of rules: centres, sizes (N, n) and log masses (N,)."""
        pool = found.pool
        size = self.problem.space.size
        order = np.flatnonzero(pool.log_mass > -np.inf)
        left = np.full(1, self.most_cells)
        cell, away, step = boxes_of(pool.boxes, likelihood.terms, order, found.log_integral, left, pool.sums)
        places, shares = nodes(NODES, size)
        ends = np.concatenate([[0.0], np.cumsum(nodes(NODES, 1)[1])]) - 0.5
        box = np.stack(np.unravel_index(np.arange(len(places)), (NODES,) * size), -1)
        middle, width = 0.5 * (ends[box] + ends[box + 1]), ends[box + 1] - ends[box]
        centres = (pool.centre[cell] + away)[:, None] + middle * step[:, None]
        flat = centres.reshape(-1, size)
        logs = self.problem.prior.log_density(self.problem.space.wrap(flat))
        if likelihood.scales.min(initial=np.inf) < np.inf:
            ranges = np.asarray(self.problem.sensor.expected(flat))
            logs = logs + likelihood.log_density(np.zeros(len(flat), np.int64), ranges)
        logs = logs + (np.log(shares) + np.log(step).sum(axis=1)[:, None]).ravel()
        return flat, (width * step[:, None]).reshape(-1, size), logs

    @property
    def _halving(self) -> Halving:
        return Halving(self.problem, self.coarse.lines)

    def _refined(self, likelihood: Likelihood, bounds: Array, floor: Array) -> Refined:
        chosen = (bounds >= floor[:, None]) & (bounds > IMPOSSIBLE_NATS)
        return self._worked_out(likelihood, self._coarse_pool(likelihood, bounds, chosen))

    def _coarse_pool(self, likelihood: Likelihood, bounds: Array, chosen: BoolArray) -> Pool:
        """The coarse cells that are chosen for each run, (M, G)."""
        coarse = self.coarse
        run, cell = map(np.ascontiguousarray, np.nonzero(chosen))  # as views, loops would be compiled twice
        centre, step = coarse.centres[cell], coarse.steps[cell]
        prior = PriorModel(*(part[cell] for part in coarse.prior))
        if coarse.models is None:
            model = models_at(self.problem, self.coarse.lines, centre, step, prior.anchor)
        else:
            model = RangeModel(*(part[cell] for part in coarse.models))
        return self._halving.pool(likelihood, run, centre, step, model, prior, bounds[run, cell])

    def _looked_closely(self, likelihood: Likelihood, bounds: Array, wanted: float) -> Refined | None:
        """One run whose readings fit nowhere in the coarse cells, of which bounds are given, (1, G).

        None if prior times likelihood does not reach `wanted`, its log, where places lie denser either.
        """
        found = denser_boxes(self.problem, self.coarse, likelihood, wanted, self.most_cells // 2)
        if found is None:
            return None
        centre, step = found.centres, found.steps
        prior = prior_model(self.problem, centre, step)
        model = models_at(self.problem, self.coarse.lines, centre, step, prior.anchor)
        run, bound = np.zeros(len(centre), dtype=np.int64), np.full(len(centre), found.best + UNSEEN_NATS)
        boxes = self._halving.pool(likelihood, run, centre, step, model, prior, bound)
        others = bounds >= found.best - SEARCH_NATS
        others[:, found.cells] = False
        pool = Pool.joined([boxes, self._coarse_pool(likelihood, bounds, others)])
        return self._worked_out(likelihood, pool)

    def _worked_out(self, likelihood: Likelihood, pool: Pool) -> Refined:
        """Integrate the cells of some runs, and halve those that jumps cross, until none of a run need be.

        A run whose cells are done is put aside: what it answers does not hang on how long others take.
        """
        runs, done = len(likelihood.readings), []
        left = np.full(runs, self.most_cells) - np.bincount(pool.run, minlength=runs)
        for _ in range(MAX_ROUNDS):
            pool, errors = self._integrated(likelihood, pool, left, runs, False)
            split = self._to_halve(pool, errors, left, runs)
            calm = ~np.isin(pool.run, pool.run[split])
            whole, whole_errors = self._integrated(likelihood, pool.rows(calm), left, runs, True)
            again = self._to_halve(whole, whole_errors, left, runs)
            ended = ~np.isin(whole.run, whole.run[again])
            done.append((whole.rows(ended), whole_errors[ended]))
            pool = Pool.joined([pool.rows(~calm), whole.rows(~ended)])
            split = np.concatenate([split[~calm], again[~ended]])
            if not len(pool.run):
                break
            left -= (2**self.problem.space.size - 1) * np.bincount(pool.run[split], minlength=runs)
            parents = pool.rows(split)
            pool = Pool.joined([pool.rows(~split), self._halving.halved(likelihood, parents)])
        else:  # what was halved last has not been looked at
            done.append(self._integrated(likelihood, pool, left, runs, True))
        errors = np.concatenate([some for _, some in done])
        return self._finished(likelihood, Pool.joined([some for some, _ in done]), errors)

    def _integrated(
        self, likelihood: Likelihood, pool: Pool, left: IntArray, runs: int, broken: bool
    ) -> tuple[Pool, Array]:
        """The cells that count, and what each may make mean and covariance err by, (N,).

        Integrated are those that are whole, or all; of others the centre is taken for the whole.
        """
        fresh = pool.rough & (broken | (pool.broken == 0))
        for _ in range(2):
            log_total = log_sums(pool.run, pool.log_mass, runs)
            order = np.flatnonzero(fresh)
            most = (pool.bound + pool.log_volume)[order]
            order = order[np.argsort(-most, kind="stable")]  # ties too: no other run may change the order
            integrate(pool.boxes, likelihood.terms, order, log_total, left, pool.sums)
            pool.rough[order] = False
            log_total = log_sums(pool.run, pool.log_mass, runs)
            counts, share = self._counts(pool, log_total, runs)
            with np.errstate(over="ignore", invalid="ignore"):
                most = (
                    np.exp(np.minimum(pool.bound + pool.log_volume - log_total[pool.run], MOST_NATS)) * counts
                )
                coarse = np.exp(np.minimum(pool.coarse - log_total[pool.run], MOST_NATS)) * counts
            fresh = ~pool.rough & (counts > 2 * pool.weigh) & (most > NEGLIGIBLE_SHARE)
            if not fresh.any():
                break
            pool.weigh = np.where(fresh, 1.5 * counts, pool.weigh)
        surprised = self._look(likelihood, pool, share * counts)
        most[surprised] = np.maximum(most[surprised], 1.0)
        errors = np.maximum(coarse, self._displaced(pool, most * pool.broken, runs))
        kept = most > DROPPED_SHARE
        return pool.rows(kept), errors[kept]

    def _displaced(self, pool: Pool, broken: Array, runs: int) -> Array:
        """What jumps may make mean and covariance err by in cells of which so much is broken, (N,).

        A jump displaces a share of a cell's mass to either side at random, so that many cells err less: by
        one over the square root of their number. Some of it has one sign where jumps run along the cells.
        """
        sums = np.bincount(pool.run, broken, runs)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            alone = np.sqrt(np.bincount(pool.run, broken**2, runs)) / sums
        share = np.clip(np.nan_to_num(alone, nan=1.0), JUMP_SHARE[self.problem.space.size], MOST_DISPLACED)
        return np.asarray(broken * share[pool.run])

    def _counts(self, pool: Pool, log_total: Array, runs: int) -> tuple[Array, Array]:
        """How much more than its mass each cell counts, (N,), and its share of the belief, (N,)."""
        space = self.problem.space
        share = np.exp(pool.log_mass - np.where(log_total > -np.inf, log_total, 0.0)[pool.run])
        mean, covariance = joined_moments(space, pool, share, runs)
        variance = covariance.diagonal(axis1=1, axis2=2).copy()
        even = share * pool.rough / 12  # over cells of which the centre alone is known
        for axis in range(space.size):
            variance[:, axis] += np.bincount(pool.run, even * pool.step[:, axis] ** 2, runs)
        variance = variance[pool.run]
        away = space.difference(pool.centre, mean[pool.run])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            apart = np.nan_to_num((away**2 / variance).max(axis=1), nan=1.0, posinf=1.0)
        return np.clip(apart, 1.0, MOST_COUNTED), share

    def _look(self, likelihood: Likelihood, pool: Pool, share: Array) -> BoolArray:
        """Cast ranges where the mass of cells is that seem whole; what does not fit there is broken."""
        size = self.problem.space.size
        surprised = np.zeros(len(pool.run), dtype=np.bool_)
        rows = np.flatnonzero(~pool.looked & ~pool.rough & (pool.broken == 0) & (share > LOOKED_AT_SHARE))
        if not len(rows) or not np.isfinite(likelihood.scales).any():
            return surprised
        pool.looked[rows] = True
        spread = pool.second[rows].diagonal(axis1=1, axis2=2) - pool.mean[rows] ** 2
        signs = np.concatenate([np.zeros((1, size)), corners(size)])
        places = pool.mean[rows][:, None] + signs * np.sqrt(np.maximum(spread, 0.0))[:, None]
        reach = corner_reach(pool.step[rows])[:, None]
        places = np.clip(places, -reach, reach)
        seen = np.asarray(self.problem.sensor.expected(pool.centre[rows][:, None] + places))
        bend = bends(pool.ranges[rows], pool.slopes[rows], places, seen)
        bad = (likelihood.in_scales(pool.run[rows], bend) > BENT_SCALES).any(axis=1)
        pool.broken[rows[bad]] = 1.0
        pool.bound[rows[bad]] += UNSEEN_NATS
        surprised[rows[bad]] = True
        return surprised

    def _to_halve(self, pool: Pool, errors: Array, left: IntArray, runs: int) -> BoolArray:
        """Which broken cells to halve: the worst, until the others may err by no more than is allowed."""
        split = np.zeros(len(errors), dtype=np.bool_)
        allowed = CALM_SHARE * self.accuracy
        errs = np.where(pool.broken > 0, errors, 0.0)
        sums = np.bincount(pool.run, errs, runs)
        for run in np.flatnonzero(sums > allowed):
            rows = np.flatnonzero((pool.run == run) & (errs > NEGLIGIBLE_SHARE))
            rows = rows[errs[rows] > WORTH_HALVING * errs[rows].max(initial=0.0)]
            rows = rows[np.argsort(errs[rows], kind="stable")]
            rows = rows[np.cumsum(errs[rows]) > LEFT_SHARE * allowed]
            most = min(HALVED_AT_ONCE, max(0, int(left[run])) // (2**self.problem.space.size - 1))
            split[rows[len(rows) - min(most, len(rows)) :]] = True
        return split

    def _finished(self, likelihood: Likelihood, pool: Pool, errors: Array) -> Refined:
        """Moments of the cells; of those in which the prior ends, the part that is possible counts."""
        space, runs = self.problem.space, len(likelihood.readings)
        cut = np.flatnonzero((pool.off > QUADRATIC_NATS) & (pool.log_mass > -np.inf))
        if len(cut):
            places, shares = nodes(CUT_NODES, space.size)
            away, level = places * pool.step[cut][:, None], pool.level[cut]
            logs = self.problem.prior.log_density(space.wrap(pool.centre[cut][:, None] + away))
            taken = quadratic(level, pool.slope[cut], pool.curve[cut], away) - level[:, None]
            with np.errstate(divide="ignore"):
                held = np.log(np.exp(logs - level[:, None]) @ shares)
            pool.log_mass[cut] += held - np.log(np.exp(taken) @ shares)
        log_total = log_sums(pool.run, pool.log_mass, runs)
        share = np.exp(pool.log_mass - np.where(log_total > -np.inf, log_total, 0.0)[pool.run])
        mean, covariance = joined_moments(space, pool, share, runs)
        bent = likelihood.in_scales(pool.run, np.where(pool.broken[:, None] > 0, 0.0, pool.bend)).sum(axis=1)
        errors = errors + BENDS_DISPLACE * bent * share
        error = np.where(log_total > -np.inf, RULE_ERROR + np.bincount(pool.run, errors, runs), 0.0)
        return Refined(mean, covariance, log_total, error, pool)


def log_sums(run: IntArray, logs: Array, runs: int) -> Array:
    """Logs of the sums of each run's terms, (N,) -> (M,)."""
    top = np.full(runs, -np.inf)
    np.maximum.at(top, run, logs)
    sums = np.bincount(run, np.exp(logs - np.where(top > -np.inf, top, 0.0)[run]), runs)
    with np.errstate(divide="ignore"):
        return np.asarray(top + np.log(sums))


def joined_moments(space: StateSpace, pool: Pool, share: Array, runs: int) -> tuple[Array, Array]:
    """Mean (M, n) and covariance (M, n, n) of cells that hold shares of their runs' beliefs."""
    mean, covariance = weighted_moments(space, pool.run, pool.centre + pool.mean, share, runs)
    for i in range(space.size):
        for j in range(space.size):
            within = pool.second[:, i, j] - pool.mean[:, i] * pool.mean[:, j]
            covariance[:, i, j] += np.bincount(pool.run, share * within, runs)
    return mean, covariance
