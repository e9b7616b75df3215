"""THE table of figures: what is told of an estimator, how runs are averaged, and where it is shown.

One entry here adds a figure; so does an entry point "rangefix.metrics" of another package:

    Metric("mae", COMPONENT, lambda runs: np.abs(runs.errors), Average.MEAN, shown=("csv", "terminal"))
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from ...arrays import Array, BoolArray
from ...extensions import extensions
from ..results import Status
from .formatting import factor, scaled, unit
from .intervals import Interval
from .run_block import RunBlock
from .scores import crps, energy_score, log_score

POSITION = ("x1", "x2")  # whose claim the energy score judges
LEVELS = (0.5, 0.9, 0.99)  # of the ellipses whose coverage is counted
COMPONENT = "component"  # the unit of a figure that has that of its component of the state
Place = Literal["csv", "terminal", "report", "compare"]
Values = Array | BoolArray | tuple[Array, Array] | None


class Average(StrEnum):
    """How the values of runs become a figure with its interval."""

    MEAN = "mean"
    ROOT_MEAN = "root mean"
    RATIO = "ratio of means"
    SHARE = "share"
    LOG_RATIO = "log ratio"


@dataclass(frozen=True)
class Metric:
    """A figure of an estimator.

    Attributes:
        name: Its column; `NAME_COMPONENT` where each component of the state has its own.
        unit: "m", "nats", "dB", "" for a plain number; COMPONENT for m, m/s or rad, shown in degrees.
        per_run: From a block of runs, values (K,), or (K, n) for a figure of each component; None if the runs
            do not tell it. For a ratio of means two such arrays; for a share one of truths, of any length;
            for a log ratio the weight of each run's `log_ratios`.
        average: How the values are averaged.
        honest: The figure of an honest estimator, against which rows have p-values; None if none is fixed.
        better: Which figures are better: "lower", "higher", or those near the "honest" one.
        shown: Where: "csv" (summary.csv, --json, gates), "terminal", "report"; "compare": run by run.
        label: What tables call it, `{}` standing for the component; the column unless given.
    """

    name: str
    unit: str
    per_run: Callable[[RunBlock], Values]
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
        arrays: list[NDArray[Any]] = [
            np.asarray(array) for array in (values if isinstance(values, tuple) else (values,))
        ]
        inner = {array.shape[1:] for array in arrays}
        if inner == {()}:
            return {self.name: tuple(arrays)}
        if inner != {(len(runs.names),)}:
            shapes = " and ".join(str(array.shape) for array in arrays)
            raise ValueError(f"metric {self.name!r}: per_run gives {shapes} for errors {runs.errors.shape}")
        return {
            self.column(name): tuple(array[:, i] for array in arrays) for i, name in enumerate(runs.names)
        }

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
        return scaled(interval, factor(component)) if self.unit == COMPONENT else interval


def _true_and_claimed(runs: RunBlock) -> tuple[Array, Array]:
    return runs.errors**2, runs.variances


def _anees(runs: RunBlock) -> Array:
    return runs.nees / len(runs.names)


def _diagonal(covariance: Array) -> Array:
    return covariance.diagonal(axis1=1, axis2=2)


def _energy_score(runs: RunBlock) -> Array:
    if not set(POSITION) <= set(runs.names):
        return np.full(len(runs.errors), np.nan)
    where = [runs.names.index(name) for name in POSITION]
    return energy_score(runs.errors[:, where], runs.covariance[:, where][:, :, where])


def _is_inside(runs: RunBlock, level: float) -> BoolArray:
    return np.asarray(runs.nees <= chdtri(len(runs.names), 1 - level))


MEAN, RATIO, SHARE, LOG_RATIO = Average.MEAN, Average.RATIO, Average.SHARE, Average.LOG_RATIO
COMPARED: tuple[Place, ...] = ("csv", "compare")
TERMINAL: tuple[Place, ...] = ("csv", "report", "terminal")
VARIANCE = "m^2 or rad^2"
METRICS = (
    Metric("G", VARIANCE, lambda runs: runs.errors**2, MEAN, shown=COMPARED, label="{} true std"),
    Metric("P", VARIANCE, lambda runs: runs.variances, MEAN, shown=COMPARED, label="{} claimed std"),
    Metric("ratio", "", _true_and_claimed, RATIO, 1.0, "honest", label="G / P of {}"),
    Metric("rmse", COMPONENT, lambda runs: runs.errors**2, Average.ROOT_MEAN, shown=("csv",)),
    Metric("bias", COMPONENT, lambda runs: runs.errors, MEAN, 0.0, "honest", label="mean error of {}"),
    Metric("anees", "", _anees, MEAN, 1.0, "honest", (*TERMINAL, "compare"), "ANEES/n"),
    Metric("nci_db", "dB", lambda runs: np.sign(runs.log_ratios), LOG_RATIO, label="NCI"),
    Metric("inclination_db", "dB", lambda runs: np.ones(len(runs.errors)), LOG_RATIO, label="inclination"),
    *(
        Metric(f"coverage_{100 * level:g}", "", partial(_is_inside, level=level), SHARE, better="honest")
        for level in LEVELS
    ),
    Metric("share_indefinite", "", lambda runs: ~runs.positive, SHARE),
    Metric("share_diverged", "", lambda runs: runs.status == Status.DIVERGED.code, SHARE),
    Metric("share_improbable", "", lambda runs: runs.improbable, SHARE),
    Metric("log_score", "nats", lambda runs: log_score(runs.nees, runs.covariance, runs.positive), MEAN),
    Metric("energy_score", "m", _energy_score, MEAN, shown=TERMINAL, label="energy score"),
    Metric("crps", COMPONENT, lambda runs: crps(runs.errors, np.sqrt(np.maximum(runs.variances, 0.0))), MEAN),
    Metric("log_evidence", "nats", lambda runs: runs.log_evidence, MEAN, better="higher"),
    Metric("belief_energy_score", "m", lambda runs: runs.belief and runs.belief.energy, MEAN),
    Metric("belief_crps", COMPONENT, lambda runs: runs.belief and runs.belief.crps, MEAN),
    Metric("belief_P", VARIANCE, lambda runs: runs.belief and _diagonal(runs.belief.spread), MEAN),
    Metric(
        "belief_main_mode_P",
        VARIANCE,
        lambda runs: runs.belief and _diagonal(runs.belief.mode_covariance),
        MEAN,
    ),
    Metric("belief_main_mode_share", "", lambda runs: runs.belief and runs.belief.mode_share, MEAN),
)


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
