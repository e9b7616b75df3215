"""Fisher information of priors and, on average over them, of readings: what Van Trees' bound is made of."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...filters.models.gaussian_prior import GaussianPrior
from ...filters.models.product_prior import WithHeading, WithVelocity
from ...filters.models.squared_cosine_prior import SquaredCosine
from ...filters.models.uniform_prior import Uniform
from ...filters.problem import Prior, Problem, RangeMap
from ...filters.space import StateSpace
from .averages.draws import SETS, set_means
from .bound import NoBoundError, require_gaussian
from .continuity import pieces_of

LOG_AT_ENDS = float(np.log(1e-12))  # a density at its ends, relative to its peak
LATTICE = 301  # points along each axis of the ellipse where a Gaussian prior counts
NODES = (24, 40)  # Gauss-Legendre nodes along the sides of a triangle: the error, the answer
FEWEST_DRAWS, RAYS = 2**14, 2**19  # of states, and of beams at all of them together
STANDARD_ERRORS = 4.0  # added to the mean information of draws


def prior_information(prior: Prior, space: StateSpace, room: RangeMap) -> Array:
    """Fisher information of a prior density, E[(d log p / d x)(d log p / d x)'], (n, n).

    Raises:
        NoBoundError: If the density is not below 1e-12 of its peak at the ends of its support, where it would
            jump, or it is of a kind that is not computed here.
    """
    if isinstance(prior, Uniform):
        raise NoBoundError("the prior is uniform: its density jumps at the ends of its support")
    if isinstance(prior, SquaredCosine):
        return prior.fisher_information
    law = gaussian_law(prior, space)
    if law is not None:
        mean, covariance = law
        _require_free(mean, covariance, space, room)
        return np.asarray(np.linalg.inv(covariance))
    if isinstance(prior, WithHeading) and prior.std is not None and isinstance(prior.prior, SquaredCosine):
        _require_narrow(prior.std)
        information = np.zeros((space.size, space.size))
        information[np.ix_(space.position_indices, space.position_indices)] = prior.prior.fisher_information
        heading = space.names.index("heading")
        information[heading, heading] = prior.std**-2
        return information
    raise NoBoundError("computed here for Gaussian and squared-cosine priors, whose densities end in nothing")


def gaussian_law(prior: Prior, space: StateSpace) -> tuple[Array, Array] | None:
    """Mean (n,) and covariance (n, n) of a prior that is Gaussian but for walls; None for another."""
    if isinstance(prior, GaussianPrior):
        return prior.peak, prior.root @ prior.root.T
    if not isinstance(prior, WithHeading | WithVelocity):
        return None
    inner = gaussian_law(prior.prior, prior.prior.space)
    if inner is None or (isinstance(prior, WithHeading) and prior.std is None):
        return None
    first = [space.names.index(name) for name in prior.prior.space.names]
    second = [space.names.index(name) for name in prior.others]
    mean, covariance = np.array(prior.mean), np.zeros((space.size, space.size))
    mean[first] = inner[0]
    covariance[np.ix_(first, first)] = inner[1]
    others = np.array([prior.std]) if isinstance(prior, WithHeading) else prior.stds
    covariance[np.ix_(second, second)] = np.diag(np.asarray(others, dtype=float) ** 2)
    return mean, covariance


def _require_free(mean: Array, covariance: Array, space: StateSpace, room: RangeMap) -> None:
    """Refuse a Gaussian that is cut off where it is not below 1e-12 of its peak, or that wraps round.

    Raises:
        NoBoundError: If they do.
    """
    where = space.position_indices
    if not room.is_free(mean[where][None])[0]:
        raise NoBoundError("the prior's peak is not in free space")
    root = np.linalg.cholesky(covariance[np.ix_(where, where)])
    whiten = np.linalg.inv(root)
    ends = (room.segments.reshape(-1, 2, 2) - mean[where]) @ whiten.T
    if len(ends):
        start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
        share = np.clip(-(start * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-300), 0, 1)
        nearest = ((start + share[:, None] * along) ** 2).sum(-1).min()
        if -0.5 * nearest > LOG_AT_ENDS:
            raise NoBoundError(
                f"walls cut the prior off at {np.sqrt(nearest):.1f} deviations, where its density is above "
                "1e-12 of its peak"
            )
    reach = np.sqrt(-2 * LOG_AT_ENDS)
    axis = np.linspace(-reach, reach, LATTICE)
    lattice = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    lattice = lattice[(lattice**2).sum(-1) <= reach**2]
    closed = lattice[~np.asarray(room.is_free(mean[where] + lattice @ root.T))]
    if len(closed):  # unknown cells, or no floor: no wall stands at the end of free space
        nearest = (closed**2).sum(-1).min()
        raise NoBoundError(
            f"free space ends at {np.sqrt(nearest):.1f} deviations of the prior, where its density is above "
            "1e-12 of its peak"
        )
    for column in np.flatnonzero(space.is_angle):
        _require_narrow(float(np.sqrt(covariance[column, column])))


def _require_narrow(std: float) -> None:
    if -0.5 * (np.pi / std) ** 2 > LOG_AT_ENDS:
        raise NoBoundError(f"the heading's deviation of {np.rad2deg(std):.0f} deg reaches half a turn")


def mean_information(problem: Problem, known: Array) -> tuple[Array, Array]:
    """Mean over the prior of the readings' information sum g g' / sigma^2, from above.

    At a known heading gradients are constant on the pieces that see the same walls, and the prior is summed
    over these; else over draws. The error is added as a matrix that no error in sight outweighs (Gershgorin),
    in coordinates in which all information is the identity: whatever the units, and however much less is
    known along one direction than along another, it is a share of what is known there.

    Args:
        problem: The problem.
        known: What is known without the readings, (n, n), positive definite.

    Returns:
        Mean information (n, n) plus its error, so that its inverse is safe, and the error (n, n).
    """
    stds = require_gaussian(problem)
    pieces = _over_pieces(problem, stds)
    if pieces is None:

        def answer(states: Array, _: Array) -> Array:
            gradients = problem.sensor.jacobian(states)
            return np.asarray(np.einsum("kbi,kbj,b->kij", gradients, gradients, stds**-2.0))

        draws = max(FEWEST_DRAWS, SETS * (RAYS // len(stds) // SETS))
        sets = set_means(problem, draws, answer)
        mean = sets.mean(axis=0)
        off, errors = sets - mean, STANDARD_ERRORS / np.sqrt(SETS)
    else:
        mean, difference = pieces
        off, errors = difference[None], 1.0
    root = np.linalg.cholesky(known + mean)
    whiten = np.linalg.inv(root)
    scatter = whiten @ off @ whiten.T
    error = errors * np.sqrt((scatter**2).sum(axis=0) / max(1, len(off) - 1))
    above = root @ np.diag(error.sum(axis=1)) @ root.T
    return mean + above, above


def _over_pieces(problem: Problem, stds: Array) -> tuple[Array, Array] | None:
    """The same as sums over pieces, and how far fewer nodes are off them; None where there are none."""
    pieces = pieces_of(problem)
    if pieces is None:
        return None
    stds = stds[~problem.sensor.blind]
    informations = np.einsum("pbi,pbj,b->pij", pieces.slopes, pieces.slopes, stds**-2.0)
    sums = []
    for nodes in NODES:
        mass = np.array(
            [_mass(problem.prior, pieces.corners[k, :n], nodes) for k, n in enumerate(pieces.counts)]
        )
        sums.append(np.einsum("p,pij->ij", mass / mass.sum(), informations))
    return sums[1], sums[1] - sums[0]


def _mass(prior: Prior, corners: Array, nodes: int) -> float:
    """The prior's probability of a convex polygon (C, 2): Gauss-Legendre rules in its triangles."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    u, v = np.meshgrid(0.5 * (x + 1), 0.5 * (x + 1), indexing="ij")
    weights = 0.25 * np.outer(w, w) * u
    one, two = corners[1:-1] - corners[0], corners[2:] - corners[0]
    doubled = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    places = corners[0] + u[..., None] * (
        (1 - v)[..., None] * one[:, None, None] + v[..., None] * two[:, None, None]
    )
    return float((np.exp(prior.log_density(places)) * weights * doubled[:, None, None]).sum())
