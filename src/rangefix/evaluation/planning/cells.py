"""What is believed, as boxes with probabilities: a prior on a lattice, or what readings leave of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from ...arrays import TWO_PI, Array, BoolArray, IntArray, wrap
from ...filters import Problem, Rangefinder, StateSpace
from ...filters.models.correlated import refuse_shared_errors
from ...filters.models.motion import Stationary
from ...filters.models.noise_of_beams import noise_of_beams
from ...filters.point_mass.grid import build_grid
from ...filters.problem import Prior
from ...filters.refined_cells.coarse_cells import CoarseCells, cover
from ...filters.refined_cells.filter import FIRST_SEED, boxes_of_each
from .one_beam import noise_width

PRIOR_CELLS = 15_000  # of a prior, about so many
MOST_IN_BOX = 4_000_000  # of the prior's box, walls included
ACCURACY = 0.1  # deviations by which the cells of a posterior may be off: plans average over many
MOST_CELLS = 30_000  # of a posterior
NEGLIGIBLE_MASS = 1e-7  # of a belief, that may be left out
NOTHING_NATS = 50.0  # below the heaviest cell there is nothing
OFF_WALLS = 1e-5  # of a cell: a centre that lay on a wall would read 0 along half of its beams
SAME_WAY = 1e-9  # rad; by which bearings of one beam differ
CHECKED, UNLIKE = 16_384, 0.2  # draws by which cells are checked, and by how much their densities may be off
WIDER, DRAWN_CELLS = 0.005, 120_000  # share by which variances of cells may be off; of draws if they are
PRIOR_DRAWS, HALVINGS = 1_000_000, 12  # of a prior with narrower parts, and of its cells
ROUNDS = 6  # of looking for the size of the cells
CLOSE = 0.9, 1.02  # how many cells there may be, over how many are wanted


@dataclass(frozen=True)
class Cells:
    """Boxes with probabilities; of width zero they are points.

    Attributes:
        space: The state space.
        centres: (N, n), m and rad.
        widths: Along each axis, (N, n); what is believed is spread evenly in each box.
        weights: Probabilities, which sum to one, (N,).
    """

    space: StateSpace
    centres: Array
    widths: Array
    weights: Array

    @staticmethod
    def of(space: StateSpace, centres: Array, weights: Array, widths: Array | float = 0.0) -> Cells:
        """Cells from arrays; the weights need not sum to one.

        Raises:
            ValueError: If there is none, or a number does not fit.
        """
        centres, weights = np.asarray(centres, dtype=float), np.asarray(weights, dtype=float)
        if centres.ndim != 2 or centres.shape != (len(weights), space.size) or not len(weights):
            raise ValueError(
                f"cells have centres (N, {space.size}) and weights (N,): {centres.shape}, {weights.shape}"
            )
        widths = np.broadcast_to(np.asarray(widths, dtype=float), centres.shape)
        total = weights.sum()
        sound = np.isfinite(centres).all() and np.isfinite(widths).all() and (widths >= 0).all()
        if not (sound and (weights >= 0).all() and 0 < total < np.inf):
            raise ValueError("cells need finite centres, and widths and weights that are at least zero")
        return Cells(space, centres, widths, weights / total)

    def heavy(self) -> Cells:
        """The same without the lightest cells, which hold NEGLIGIBLE_MASS together."""
        order = np.argsort(self.weights)
        kept = np.sort(order[np.cumsum(self.weights[order]) > NEGLIGIBLE_MASS])
        return Cells.of(self.space, self.centres[kept], self.weights[kept], self.widths[kept])

    def merged(self, pitch: Array) -> Cells:
        """Cells no finer than a pitch along each axis, (n,): those of one place become one."""
        places = np.floor((self.centres - self.centres.min(axis=0)) / pitch).astype(np.int64)
        shape = places.max(axis=0) + 1
        _, group = np.unique(np.ravel_multi_index(tuple(places.T), tuple(shape)), return_inverse=True)
        weights = np.bincount(group, self.weights).astype(float)
        share = self.weights / weights[group]
        centres: Array = np.stack([np.bincount(group, share * column) for column in self.centres.T], axis=1)
        squares = (self.centres - centres[group]) ** 2 + self.widths**2 / 12
        spread = np.stack([np.bincount(group, share * column) for column in squares.T], axis=1)
        return Cells.of(self.space, centres, weights, np.sqrt(12 * spread))

    @property
    def away(self) -> Array:
        """Centres as differences from the mean, angles the short way round, (N, n)."""
        mean, _ = self.space.moments(self.centres, self.weights)
        away = self.space.difference(self.centres, mean)
        return np.asarray(away - self.weights @ away)

    @property
    def covariance(self) -> Array:
        """Covariance, the spread in the cells included, (n, n)."""
        away = self.away
        spread = np.diag(self.weights @ self.widths**2 / 12)
        return np.asarray((away * self.weights[:, None]).T @ away + spread)


def check_plannable(problem: Problem) -> Rangefinder:
    """The rangefinder of a problem that measurements can be planned for.

    Raises:
        ValueError: If the state has other components, the sensor is somebody else's, or beams share errors.
    """
    if problem.space.names not in (("x1", "x2"), ("x1", "x2", "heading")):
        names = ", ".join(problem.space.names)
        raise ValueError(f"measurements are planned for x1, x2 and heading, not for {names}")
    if not isinstance(problem.sensor, Rangefinder):
        kind = type(problem.sensor).__name__
        raise ValueError(f"measurements are planned for a Rangefinder, whose beams can be turned, not {kind}")
    refuse_shared_errors(problem.sensor, "planning")
    return problem.sensor


def beams_alike(sensor: Rangefinder) -> bool:
    """Whether all beams have the same noise, so that a beam may be turned anywhere."""
    return noise_of_beams(sensor.noise, 0, len(sensor.bearings)) is sensor.noise


def noise_widths(sensor: Rangefinder) -> Array:
    """Deviations of Gaussian noise that is as wide as that of each beam, m, (B,): see `noise_width`."""
    noise, beams = sensor.noise, len(sensor.bearings)
    lower, upper = sensor.room.bounds
    reach = float(np.hypot(*(upper - lower)))
    if beams_alike(sensor):
        return np.full(beams, noise_width(noise, 0.0, reach))
    return np.array([noise_width(noise_of_beams(noise, beam, beams), 0.0, reach) for beam in range(beams)])


def turned(sensor: Rangefinder, bearings: Array) -> Rangefinder:
    """The same rangefinder with beams in other directions, or with some of its own.

    Raises:
        ValueError: As `own_beams`, if its beams have noise of their own each.
    """
    noise = sensor.noise
    if not beams_alike(sensor):
        noise = noise_of_beams(noise, own_beams(sensor, bearings), len(sensor.bearings))
    return replace(sensor, bearings=np.asarray(bearings, dtype=float), noise=noise)


def own_beams(sensor: Rangefinder, bearings: Array) -> IntArray:
    """Which of its own beams, whose noise differs, look in some directions, (D,), from 0.

    A full turn is no difference. Where several look one way, each is meant as often as it can be.

    Raises:
        ValueError: If a beam is none of its own, or is asked for alone where another looks the same way.
    """
    found, bearings = list[int](), np.asarray(bearings, dtype=float)
    for place, bearing in enumerate(bearings):
        same = np.flatnonzero(np.abs(wrap(sensor.bearings - bearing)) < SAME_WAY)
        if not len(same):
            raise ValueError(
                "each beam of this sensor has noise of its own: only its own beams can be planned with"
            )
        asked = np.flatnonzero(np.abs(wrap(bearings - bearing)) < SAME_WAY)
        noises = {repr(noise_of_beams(sensor.noise, int(beam), len(sensor.bearings))) for beam in same}
        if len(noises) > 1 and len(asked) < len(same):
            raise ValueError(
                f"{len(same)} beams of this sensor look along {np.rad2deg(bearing):g} deg, with noise of "
                "their own each: name all of its beams"
            )
        found.append(int(same[np.searchsorted(asked, place) % len(same)]))
    return np.array(found, dtype=np.int64)


def prior_cells(problem: Problem, most: int = PRIOR_CELLS) -> Cells:
    """A prior as cells of one size, about so many as asked for; of draws, where these miss a part of it.

    So are as many as a plan takes where they are wider than the prior: a Gaussian one in cells of half its
    deviation, as at an unknown heading, has 2 % more variance.

    Raises:
        ValueError: If measurements cannot be planned for the problem.
    """
    check_plannable(problem)
    lower, upper = problem.prior.support
    size, share = upper - lower, 1.0
    grid = None
    for _ in range(ROUNDS):
        counts = _counts(size, problem.space.is_angle, most / share)
        grid = build_grid(problem.prior, problem.space, size / counts * (1 + 1e-12), MOST_IN_BOX, OFF_WALLS)
        kept = int((grid.log_mass > -np.inf).sum())
        if CLOSE[0] * most <= kept <= CLOSE[1] * most or np.prod(counts) / share > MOST_IN_BOX / 4:
            break
        share = max(share * kept / most, 1e-2)
    assert grid is not None
    cells = Cells.of(problem.space, grid.centres, np.exp(grid.log_mass), grid.step).heavy()
    if not _follow(cells, problem.prior):
        return _drawn_cells(problem, grid.step, most)
    if most < PRIOR_CELLS or _as_wide(cells, problem.prior):
        return cells
    return _drawn_cells(problem, grid.step, DRAWN_CELLS)


def _follow(cells: Cells, prior: Prior) -> bool:
    """Whether a prior's densities at centres sum to 1 and have its mean: not where a part is narrower."""
    drawn = np.exp(prior.log_density(prior.sample(CHECKED, np.random.default_rng(FIRST_SEED)))).mean()
    density = np.exp(prior.log_density(cells.centres))
    found = np.array([density @ cells.widths.prod(axis=1), cells.weights @ density / drawn])
    return bool((np.abs(found - 1) < UNLIKE).all())


def _as_wide(cells: Cells, prior: Prior) -> bool:
    """Whether cells have the prior's variances."""
    found, wanted = np.diagonal(cells.covariance), np.diagonal(np.asarray(prior.covariance))
    return bool((np.abs(found - wanted) <= WIDER * wanted).all())


def _drawn_cells(problem: Problem, pitch: Array, most: int) -> Cells:
    """A prior with parts too narrow for cells of a pitch, (n,): draws, put together in up to so many cells.

    Each cell has the mean and the spread of the draws in it, however narrow they lie.
    """
    states = problem.prior.sample(PRIOR_DRAWS, np.random.default_rng(FIRST_SEED))
    drawn = Cells.of(problem.space, states, np.ones(PRIOR_DRAWS))
    found = drawn.merged(pitch)
    for _ in range(HALVINGS):
        pitch = 0.5 * pitch
        finer = drawn.merged(pitch)
        if len(finer.weights) > most:
            break
        found = finer
    return found.heavy()


def _counts(size: Array, is_angle: BoolArray, total: float) -> Array:
    """Cells along each axis of a box: nearly square in the plane, and a heading's by the same count."""
    lengths = np.where(is_angle, size[~is_angle].max(), size)
    counts: Array = np.maximum(1.0, np.round(lengths * (total / lengths.prod()) ** (1 / len(size))))
    return counts


def posterior_cells(problem: Problem, readings: Array, pitch: Array | None = None) -> list[Cells]:
    """What readings leave of a problem's prior, run by run: cells that follow the readings.

    Args:
        problem: Its sensor has the beams that were read.
        readings: (M, B), m; inf = no return.
        pitch: Cells are merged that are finer along each axis, (n,).

    Raises:
        ValueError: If measurements cannot be planned for the problem, or no place explains the readings of a
            run.
    """
    found = cells_of(problem, coarse_cells(problem), readings, pitch)
    possible = [cells for cells in found if cells is not None]
    if len(possible) < len(found):
        raise ValueError(
            f"{len(found) - len(possible)} of {len(found)} runs have readings that no place explains"
        )
    return possible


def coarse_cells(problem: Problem, before: Cells | None = None) -> CoarseCells:
    """Coarse cells over a problem's prior, or over what earlier readings left of it.

    Raises:
        ValueError: If measurements cannot be planned for the problem.
    """
    check_plannable(problem)
    still = replace(problem, motion=Stationary(problem.space))
    where = None if before is None else partial(_near, before)
    return cover(still, np.zeros(problem.space.size), FIRST_SEED, where)


def cells_of(
    problem: Problem, coarse: CoarseCells, readings: Array, pitch: Array | None = None
) -> list[Cells | None]:
    """What readings leave of coarse cells, run by run, None where it is nothing; see `posterior_cells`."""
    still = replace(problem, motion=Stationary(problem.space))
    found: list[Cells | None] = []
    for centres, widths, logs in boxes_of_each(still, coarse, readings[:, None], ACCURACY, MOST_CELLS):
        most = logs.max(initial=-np.inf)
        if most == -np.inf:
            found.append(None)
            continue
        held = logs > most - NOTHING_NATS
        cells = Cells.of(problem.space, centres[held], np.exp(logs[held] - most), widths[held])
        found.append((cells if pitch is None else cells.merged(pitch)).heavy())
    return found


def _near(cells: Cells, centres: Array, sizes: Array) -> BoolArray:
    """Which boxes lie on some cells or beside them: centres and sizes (G, n), of one size but at edges."""
    reach = sizes.max(axis=0) + 0.5 * cells.widths.max(axis=0)
    places = cells.centres
    for axis in np.flatnonzero(cells.space.is_angle):
        turn = TWO_PI * np.eye(len(reach))[axis]
        places = np.concatenate([places - turn, places, places + turn])
    distances, _ = cKDTree(places / reach).query(centres / reach, p=np.inf, distance_upper_bound=1.0)
    return np.isfinite(distances)
