"""A posterior as lattices, one for each mode, each as fine as the accuracy asked for needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import Array
from .gauss_newton import Peaks
from .lattices.lattice import Lattice, Limits, ball, grow, halved, shifted
from .lattices.quadrature import NOWHERE, Accuracy, Quadrature
from .target import Target, TooManyCells

PEAK_MARGIN_NATS = 40.0  # below the best score at which a peak still counts: jumps of the range stop climbs
FAR_BELOW_NATS = 1000.0  # what counts: no lattice about a peak there gets as high
MAX_AXIS_HALVINGS, FALLEN_NATS = 12, 6.0  # an axis is halved until its density has fallen so far at both ends
PASSED_NATS = 3.0  # above all points of lattices that hold it, at which a peak says that they pass it by
LOBE_NATS = 6.0  # below the best mode's peak at which another is taken for a lobe of something wide
MAX_CELLS_FACTOR = 3.0  # of a Gaussian's: of more, lobes and modes in cut axes have their steps doubled
MANY_CELLS = 10_000  # or as many as MAX_CELLS_FACTOR allows: of more, the usual steps are doubled at first
MAX_STEP_FACTOR = 100.0  # of the usual steps: from there on they are doubled no more
MAX_HALVINGS = 500  # of steps of a posterior's lattices, should none be fine enough
SEARCH_SHARE = 0.4  # of the work: beyond it no further mode is looked for
MODE_SHARE = 0.1  # of the work: what the first lattice of one mode may take
SHIFTS = (0.2, 0.8)  # steps by which a check's origin lies off, drawn with a fixed seed
IDLE_HALVINGS, LEAST_PROGRESS = 4, 0.9  # after so many an error must have fallen to so much, or it stays
AXIS_RADIUS = 3.0  # standard deviations of a peak at which the density along an axis is looked at first


def with_lattices(
    target: Target, peaks: Peaks, accuracy: Accuracy, known: Quadrature = NOWHERE
) -> Quadrature:
    """Lay a lattice about each of a posterior's peaks, with the usual steps or wider ones: see `refined`.

    A mode known already gives way where one of the peaks lies in its cells, far above all its points: its
    lattice passes by what is narrower than its steps.

    Args:
        target: The posterior.
        peaks: Points near modes.
        accuracy: How good.
        known: Modes known already.

    Returns:
        Those and the new ones; of new ones as many as the work allows.

    Raises:
        TooManyCells: If a mode fills more cells than allowed.
    """
    known = _without_passed_by(known, peaks)
    left = (peaks.score >= peaks.score.max() - PEAK_MARGIN_NATS) & ~known.holds(peaks.states)
    for place in np.lexsort((-peaks.score, -peaks.log_density)):
        if left[place]:
            if known.modes and target.work.spent > SEARCH_SHARE * target.work.limit:
                break
            level = known.level - accuracy.margin
            if peaks.log_density[place] < level - FAR_BELOW_NATS:
                break  # the best density comes first; a lattice there would be grown in vain
            peak, information = peaks.states[place], peaks.information[place]
            mode = _grown(target, peak, information, accuracy, Limits(known.modes, level))
            left &= ~mode.holds(peaks.states)
            if mode.logs.max() > level:
                known = Quadrature((*known.modes, mode))
    return known


def _without_passed_by(known: Quadrature, peaks: Peaks) -> Quadrature:
    """The modes but those that hold a peak of which no mode has a point nearly as high."""
    kept, held = set(), np.zeros(len(peaks.states), np.bool_)
    for mode in sorted(known.modes, key=lambda mode: float(-mode.logs.max())):
        inside = mode.holds(peaks.states)
        if not (inside & ~held & (peaks.log_density > mode.logs.max() + PASSED_NATS)).any():
            kept.add(id(mode))
        held |= inside
    if len(kept) == len(known.modes):
        return known
    return replace(known, modes=tuple(mode for mode in known.modes if id(mode) in kept))


def refined(target: Target, found: Quadrature, accuracy: Accuracy) -> Quadrature:
    """Modes with their spacing halved, the worst axis at a time, until together they err by little enough.

    No point is worked out twice. A mode of as many cells as allowed stays as it is, and one that would have
    more; if its error alone is too large, the others are as good as they would be without it. Where a finer
    mode grows into others that were found after it, it takes their points, as it had their places when they
    were found.
    """
    if not found.modes:
        return found
    edge, level = accuracy.edge(found.modes[0].space.size), found.level - accuracy.margin
    stay: list[Lattice] = []
    for _ in range(MAX_HALVINGS):
        errors = found.errors
        squares = errors.max(axis=1) ** 2
        full = np.array(
            [
                len(mode.keys) > accuracy.most_cells / 2 or any(mode is each for each in stay)
                for mode in found.modes
            ]
        )
        allowed, lost = accuracy.error**2, squares[full].sum()
        if squares[~full].sum() <= (allowed - lost if lost < allowed else allowed):
            return found
        worst = int(np.where(full, -1.0, squares).argmax())
        if not target.work.has(target.cost * (found.cells + 2 * len(found.modes[worst].keys)) * 1.5):
            return found  # what is left is for the checks
        before, mode, after = found.modes[:worst], found.modes[worst], found.modes[worst + 1 :]
        axis = errors[worst] == errors[worst].max()
        try:
            mode = halved(mode, axis, target.log_density, Limits(before, level, edge, accuracy.most_cells))
        except TooManyCells:
            stay.append(mode)
            continue
        after = tuple(later.without(mode) for later in after)
        kept = (*before, mode, *(later for later in after if later.logs.max() > -np.inf))
        found = replace(found, modes=kept)
    return found


def verified(target: Target, check: Target, found: Quadrature, accuracy: Accuracy) -> Quadrature:
    """Modes with lattices of the same steps beside them, which say how good they are; both finer if need be.

    Args:
        target: The posterior.
        check: The same from a prior that was worked out otherwise, if there is one; else the same.
        found: Its modes.
        accuracy: How good they are to be.
    """
    edge, level = accuracy.edge(found.modes[0].space.size), found.level - accuracy.margin
    most = accuracy.most_cells
    rng = np.random.default_rng(0)
    found = replace(found, modes=tuple(mode for mode in found.modes if mode.logs.max() > level))
    checks: tuple[Lattice, ...] = ()
    try:
        for mode in found.modes:
            shift = rng.uniform(*SHIFTS, mode.space.size)
            limits = Limits(checks, level, edge, 2 * most)
            checks = (*checks, shifted(mode, check.log_density, limits, shift))
    except TooManyCells:
        return replace(found, checks=())
    found, best = replace(found, checks=checks), np.inf
    if not found.modes or not np.isfinite(found.error_of_sums):
        return found
    for turn in range(MAX_HALVINGS):
        if found.error_to_lower <= accuracy.error or (
            turn % IDLE_HALVINGS == 0 and found.error_to_lower > LEAST_PROGRESS * best
        ):
            return found
        best = found.error_to_lower if turn % IDLE_HALVINGS == 0 else best
        sizes = np.array([len(mode.keys) for mode in found.modes])
        gaps = np.maximum(found.gaps(), found.errors.max(axis=1))
        gaps[2 * sizes > most] = -1.0
        worst = int(gaps.argmax())
        if gaps[worst] < 0 or not target.work.has(2.5 * sizes[worst] * (target.cost + check.cost)):
            return found
        axis = found.errors[worst] == found.errors[worst].max()
        limits = Limits(found.modes[:worst], level, edge, most)
        aside = Limits(found.checks[:worst], level, edge, 2 * most)
        try:
            mode = halved(found.modes[worst], axis, target.log_density, limits)
            other = halved(found.checks[worst], axis, check.log_density, aside)
        except TooManyCells:
            return found
        pairs = [*zip(found.modes[:worst], found.checks[:worst], strict=True), (mode, other)]
        later = zip(found.modes[worst + 1 :], found.checks[worst + 1 :], strict=True)
        pairs += [(one.without(mode), two.without(other)) for one, two in later]
        modes, checks = zip(*[pair for pair in pairs if pair[0].logs.max() > -np.inf], strict=True)
        found = Quadrature(modes, checks, found.missed)
    return found


def _grown(target: Target, peak: Array, information: Array, accuracy: Accuracy, limits: Limits) -> Lattice:
    """A mode's first lattice.

    Its steps are doubled where it takes too many cells: where they were cut, until they are whole; then until
    it takes no more than a share of the work, so that others can be found and all of them be checked.
    """
    space, spacing, edge = target.sensor.space, accuracy.spacing, accuracy.edge(len(peak))
    axes, shares = _axes(target, peak, information)
    ends = np.sqrt(2 * edge) / spacing  # where a Gaussian's does: all these points are asked anyway
    start = ball(space.size, ends)
    many = int(MAX_CELLS_FACTOR * len(ball(space.size, 1 + ends)))
    lobe = target.log_density(peak[None])[0] < limits.level + accuracy.margin - LOBE_NATS
    affordable = max(many, int(MODE_SHARE * target.work.limit / target.cost))
    while True:
        basis, usual = spacing * axes * shares, not lobe and (shares >= 1).all()
        first = max(MANY_CELLS, many) if (shares == 1).all() else affordable
        most = min(first if usual else many, accuracy.most_cells)
        try:
            bounded = limits._replace(margin=edge, most=most)
            return grow(space, target.log_density, peak, basis, start, bounded)
        except TooManyCells:
            if shares.min() > MAX_STEP_FACTOR or not target.work.has(target.cost):
                raise
            shares = np.minimum(2 * shares, 1.0) if (shares < 1).any() else 2 * shares


def _axes(target: Target, peak: Array, information: Array) -> tuple[Array, Array]:
    """The principal axes of a mode, and what share of each to take.

    Returns:
        A standard deviation of a Gaussian with that information along each axis, in columns, (n, n). Shares,
        (n,): 1, or half of it so often that the density ends on both sides: that information is of the beams
        that fit, and jumps of others may cut it.
    """
    unit = 1 / np.sqrt(np.diagonal(information))
    values, vectors = np.linalg.eigh(unit[:, None] * information * unit)
    axes = unit[:, None] * vectors / np.sqrt(values)
    shares = 0.5 ** np.arange(MAX_AXIS_HALVINGS)
    steps = AXIS_RADIUS * shares[:, None, None, None] * np.array([1.0, -1.0])[:, None, None] * axes.T
    states = np.vstack([peak, peak + steps.reshape(-1, len(peak))])
    logs = target.log_density(target.sensor.space.wrap(states))
    if logs[0] == -np.inf:
        return axes, np.ones(len(peak))
    inside = logs[0] - logs[1:].reshape(MAX_AXIS_HALVINGS, 2, -1).max(axis=1) < FALLEN_NATS
    inside[-1] = True
    return axes, shares[inside.argmax(axis=0)]
