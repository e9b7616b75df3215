"""THE table of figures: what is told of an estimator, how runs are averaged, and where it is shown.

One entry here adds a figure; so does an entry point "rangefix.metrics" of another package:

    Metric("mae", COMPONENT, lambda runs: np.abs(runs.errors), "mean", shown=("csv", "terminal"))
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, BoolArray
from ...extensions import extensions
from ...filters.space import LEAST_RESULTANT
from ..results import BeliefScores, HalfArray, SavedBounds, Status
from .averages import Average
from .formatting import factor, scaled, unit
from .intervals import Interval
from .scores import CorrelationAxes, crps, energy_score, log_score

POSITION = ("x1", "x2")  # whose claim the energy score judges
LEVELS = (0.5, 0.9, 0.99)  # of the ellipses whose coverage is counted
MAX_ERROR = 0.05  # deviations of the posterior by which numerical errors may shift mean and covariance
MIN_EFFECTIVE = 50  # particles; plain filters with fewer err by up to 365 times the claim, with more by 1.07
COMPONENT = "component"  # the unit of a figure that has that of its component of the state
Place = Literal["csv", "terminal", "report", "compare"]


class RunBlock:
    """Some runs of an estimator after one step, as metrics see them: K that went well, of M planned.

    Attributes:
        names: Components of the state.
        errors: Truth minus estimate, (K, n).
        covariance: Claimed, (K, n, n).
        log_evidence: Of the measurements so far, nats, (K,); NaN where the estimator gives none.
        improbable: Which met measurements that the estimator's model all but excludes, (K,).
        status: Codes of `Status` of the planned runs, (M,).
        diagnostics: What the estimator says of its own computation, by the names in `DIAGNOSTICS`, (K,) each.
        belief: What draws from the beliefs come to, of the runs that have them; None if none has.
        bounds: How good anybody could be with this set of beams after this step; None if it was not saved.
        draws: Some of these draws as `results/draws.py` keeps them, (K, S, n); None if there are none.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        errors: Array,
        covariance: Array,
        *,
        log_evidence: Array | None = None,
        improbable: BoolArray | None = None,
        status: NDArray[np.int8] | None = None,
        belief: BeliefScores | None = None,
        diagnostics: Mapping[str, Array] = MappingProxyType({}),
        draws: HalfArray | None = None,
        bounds: SavedBounds | None = None,
    ) -> None:
        runs = len(errors)
        self.names, self.errors, self.covariance, self.draws = names, errors, covariance, draws
        self.log_evidence = np.full(runs, np.nan) if log_evidence is None else log_evidence
        self.improbable = np.zeros(runs, dtype=bool) if improbable is None else improbable
        self.status = np.zeros(runs, dtype=np.int8) if status is None else status
        self.diagnostics, self.bounds = diagnostics, bounds
        sampled = np.zeros(0, dtype=bool) if belief is None else np.isfinite(belief.energy)
        self.belief = (
            BeliefScores(*(array[sampled] for array in belief)) if belief and sampled.any() else None
        )

    @property
    def made(self) -> NDArray[np.int8]:
        """Codes of `Status` of the runs that were made."""
        return np.asarray(self.status[self.status != Status.PENDING.code])

    @cached_property
    def correlation_axes(self) -> CorrelationAxes:
        """Principal axes of what is claimed."""
        return CorrelationAxes.of(self.covariance)

    @property
    def positive(self) -> BoolArray:
        """Which covariances are positive definite, (K,)."""
        return self.correlation_axes.positive

    @cached_property
    def nees(self) -> Array:
        """Normalised estimation errors squared e' P^-1 e, (K,)."""
        return self.correlation_axes.nees(self.errors)

    @property
    def effective_particles(self) -> Array | None:
        """Effective numbers of particles, (K,); None for an estimator without particles."""
        return self.diagnostics.get("effective_particles")

    @property
    def collapsed(self) -> BoolArray | None:
        """Which have so few effective particles that their covariance means little, (K,)."""
        numbers = self.effective_particles
        return None if numbers is None else np.asarray(numbers < MIN_EFFECTIVE)

    @property
    def undirected(self) -> BoolArray | None:
        """Which have headings so evenly spread that none is their mean, (K,)."""
        lengths = self.diagnostics.get("mean_resultant")
        return None if lengths is None else np.asarray(lengths < LEAST_RESULTANT)

    @property
    def inaccurate(self) -> BoolArray | None:
        """Which have a numerical error that matters, other than for want of a mean heading, (K,)."""
        errors = self.diagnostics.get("numerical_error")
        if errors is None:
            return None
        undirected = self.undirected
        return np.asarray((errors > MAX_ERROR) & (True if undirected is None else ~undirected))

    @property
    def variances(self) -> Array:
        """Claimed variances, (K, n)."""
        return self.covariance.diagonal(axis1=1, axis2=2)


@dataclass(frozen=True)
class Metric:
    """A figure of an estimator.

    Attributes:
        name: Its column; `NAME_COMPONENT` where each component of the state has its own.
        unit: "m", "nats", "dB", "" for a plain number; COMPONENT for m, m/s or rad, shown in degrees; "%" for
            a share, 0 to 1, shown in per cent.
        per_run: From a block of runs, values (K,), or (K, n) for a figure of each component; None if the runs
            do not tell it. For a ratio of means two such arrays; for "over mean" too, the first of one
            number alone; for a share one of truths, of any length; for a log ratio squared errors over what
            is claimed for them.
        average: How the values are averaged: see `averages.py`.
        honest: The figure of an honest estimator, against which rows have p-values; None if none is fixed.
        better: Which figures are better: "lower", "higher", or those near the "honest" one.
        shown: Where: "csv" (summary.csv, --json, gates), "terminal", "report"; means and shares
            also in "compare", run by run.
        label: What tables call it, `{}` standing for the component; the column unless given.
    """

    name: str
    unit: str
    per_run: Callable[[RunBlock], Array | BoolArray | tuple[Array, Array] | None]
    average: Average
    honest: float | None = None
    better: Literal["lower", "higher", "honest"] = "lower"
    shown: tuple[Place, ...] = ("csv", "report")
    label: str = ""

    def column(self, component: str) -> str:
        """Its column for a component; "" for that of the whole state."""
        return f"{self.name}_{component}" if component else self.name

    def values(self, runs: RunBlock) -> dict[str, tuple[Array, ...]]:
        """The values of runs by column: one array (K,), or the two whose means are divided.

        Raises:
            ValueError: If `per_run` gives another shape.
        """
        values = self.per_run(runs)
        if values is None:
            return {}
        arrays = np.stack(values if isinstance(values, tuple) else (values,))
        if arrays.ndim == 2:
            return {self.name: tuple(arrays)}
        if arrays.shape[2:] != (len(runs.names),):
            shape = arrays.shape[1:]
            raise ValueError(f"metric {self.name!r}: per_run gives {shape} for errors {runs.errors.shape}")
        return {self.column(name): tuple(arrays[..., i]) for i, name in enumerate(runs.names)}

    def short_label(self, component: str = "") -> str:
        """What a table calls it, without its unit."""
        label = self.label or self.name
        return label.replace("{}", component) if "{}" in label else f"{label} {component}".strip()

    def full_label(self, component: str = "") -> str:
        """What a table calls it, with its unit and which figures are better."""
        shown = unit(component) if self.unit == COMPONENT else self.unit
        hint = "higher is better" if self.better == "higher" else ""
        hint = hint if self.honest is None else f"{self.honest:g} = honest"
        return self.short_label(component) + (f", {shown}" if shown else "") + (f" ({hint})" if hint else "")

    def in_shown_unit(self, interval: Interval, component: str = "") -> Interval:
        """The figure in the unit of its label."""
        return scaled(interval, {"%": 100.0, COMPONENT: factor(component)}.get(self.unit, 1.0))


def _diagonal(covariance: Array) -> Array:
    return covariance.diagonal(axis1=1, axis2=2)


def _energy_score(runs: RunBlock) -> Array:
    if not set(POSITION) <= set(runs.names):
        return np.full(len(runs.errors), np.nan)
    where = [runs.names.index(name) for name in POSITION]
    return energy_score(runs.errors[:, where], runs.covariance[:, where][:, :, where])


def _is_inside(runs: RunBlock, level: float) -> BoolArray:
    from scipy.special import chdtri

    return np.asarray(runs.nees <= chdtri(len(runs.names), 1 - level))


def _for_every_run(variances: Array | None, runs: RunBlock) -> Array | None:
    return None if variances is None else np.broadcast_to(variances, runs.errors.shape)


def _bound(runs: RunBlock) -> Array | None:
    return _for_every_run(runs.bounds and runs.bounds.bound, runs)


def _optimum(runs: RunBlock) -> Array | None:
    return _for_every_run(runs.bounds and runs.bounds.optimum, runs)


def _efficiency(runs: RunBlock) -> tuple[Array, Array] | None:
    best = _optimum(runs)
    return None if best is None else (best, runs.errors**2)


def _least_efficiency(runs: RunBlock) -> tuple[Array, Array] | None:
    bound = _bound(runs)
    return None if bound is None or _optimum(runs) is not None else (bound, runs.errors**2)


COMPARED: tuple[Place, ...] = ("csv", "compare")
TERMINAL: tuple[Place, ...] = ("csv", "report", "terminal")
VARIANCE = "m^2 or rad^2"
METRICS = (
    Metric("G", VARIANCE, lambda runs: runs.errors**2, "mean", shown=COMPARED, label="{} true std"),
    Metric("P", VARIANCE, lambda runs: runs.variances, "mean", shown=COMPARED, label="{} claimed std"),
    Metric("ratio", "", lambda runs: (runs.errors**2, runs.variances), "ratio of means", 1.0, "honest",
           label="G / P of {}"),
    Metric("bound", VARIANCE, _bound, "mean", shown=("csv",), label="bound of {} std"),
    Metric("optimum", VARIANCE, _optimum, "mean", shown=("csv",), label="best possible std of {}"),
    Metric("efficiency", "%", _efficiency, "over mean", better="higher", shown=TERMINAL,
           label="efficiency in {}"),
    Metric("efficiency_at_least", "%", _least_efficiency, "over mean", better="higher", shown=TERMINAL,
           label="efficiency in {} at least"),
    Metric("rmse", COMPONENT, lambda runs: runs.errors**2, "root mean", shown=("csv",)),
    Metric("bias", COMPONENT, lambda runs: runs.errors, "mean error", 0.0, "honest",
           label="mean error of {}"),
    Metric("anees", "", lambda runs: runs.nees / len(runs.names), "mean", 1.0, "honest",
           (*TERMINAL, "compare"), "ANEES/n"),
    Metric("nci_db", "dB", lambda runs: runs.nees, "absolute log ratio", label="NCI"),
    Metric("inclination_db", "dB", lambda runs: runs.nees, "log ratio", label="inclination"),
    *(
        Metric(f"coverage_{100 * level:g}", "%", partial(_is_inside, level=level), "share", None, "honest",
               label=f"inside the {100 * level:g} % ellipse")
        for level in LEVELS
    ),
    Metric("share_indefinite", "%", lambda runs: ~runs.positive, "share", label="covariance not positive"),
    Metric("share_diverged", "%", lambda runs: runs.made == Status.DIVERGED.code, "share",
           label="diverged"),
    Metric("share_improbable", "%", lambda runs: runs.improbable, "share", shown=("csv", "terminal"),
           label="improbable measurements"),
    Metric("effective_particles", "", lambda runs: runs.effective_particles, "mean", better="higher",
           shown=TERMINAL, label="effective particles"),
    Metric("share_collapsed", "%", lambda runs: runs.collapsed, "share",
           label=f"fewer than {MIN_EFFECTIVE} effective particles"),
    Metric("share_inaccurate", "%", lambda runs: runs.inaccurate, "share",
           label=f"numerical error above {MAX_ERROR:g} deviations"),
    Metric("share_undirected", "%", lambda runs: runs.undirected, "share", label="no mean heading"),
    Metric("log_score", "nats", lambda runs: log_score(runs.nees, runs.covariance, runs.positive), "mean",
           label="log score"),
    Metric("energy_score", "m", _energy_score, "mean", shown=TERMINAL, label="energy score"),
    Metric("crps", COMPONENT, lambda runs: crps(runs.errors, np.sqrt(np.maximum(runs.variances, 0.0))),
           "mean", label="CRPS of {}"),
    Metric("log_evidence", "nats", lambda runs: runs.log_evidence, "mean", better="higher",
           label="log evidence"),
    Metric("belief_energy_score", "m", lambda runs: runs.belief and runs.belief.energy, "mean",
           label="energy score of the belief"),
    Metric("belief_crps", COMPONENT, lambda runs: runs.belief and runs.belief.crps, "mean",
           label="CRPS of the belief in {}"),
    Metric("belief_P", VARIANCE, lambda runs: runs.belief and _diagonal(runs.belief.spread), "mean",
           shown=("csv",)),
    Metric("belief_main_mode_P", VARIANCE,
           lambda runs: runs.belief and _diagonal(runs.belief.mode_covariance), "mean", shown=("csv",)),
    Metric("belief_main_mode_share", "%", lambda runs: runs.belief and runs.belief.mode_share, "mean",
           label="share of the main mode"),
)  # fmt: skip


def metrics() -> tuple[Metric, ...]:
    """The table: our figures, and those of installed packages, in the order of their columns.

    What another package offers is left out with a warning if it is no `Metric`, or has the name of another.
    """
    table = {metric.name: metric for metric in METRICS}
    for name, offered in extensions("rangefix.metrics").items():
        if isinstance(offered, Metric) and offered.name not in table:
            table[offered.name] = offered
        else:
            why = "has a name that is taken" if isinstance(offered, Metric) else "is no Metric"
            warnings.warn(f"rangefix.metrics: {name!r} {why}", RuntimeWarning, stacklevel=2)
    return tuple(table.values())
