"""Two results side by side: what differs in config, versions and numbers, and what of it may be chance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import unified_diff
from itertools import product
from typing import Any

import numpy as np

from ...arrays import Array
from ...errors import listed
from ..consistency.formatting import beams_in_words, factor, unit
from ..consistency.intervals import Interval, Moments, sign_test
from ..consistency.metrics import COMPONENT, Metric, RunBlock, metrics
from ..consistency.summarise import run_blocks
from ..results import Results, Status

LEVEL = 0.05  # below it a difference is no chance, after Holm's correction for the number of differences
MAX_LISTED = 5  # estimators, or sets of beams, of results that share none
ONE = Interval(1.0, 1.0, 1.0)
COMPARED_AS = {"G": "mse", "P": "claimed"}  # run by run they are no covariances


@dataclass(frozen=True)
class Difference:
    """One figure of one estimator on one set of beams at one step, in A and in B.

    Attributes:
        estimator, beams, step: Whose.
        figure: "mse_NAME" (mean squared error, m^2 or rad^2), "claimed_NAME" (mean claimed variance),
            "anees" (NEES / n), or "ok" (share of runs that went well).
        runs: Pairs of runs that went well in both; for "ok", all that were made in both.
        a, b: The figure in each, over these runs.
        change: b - a with its 95 % interval.
        p: Two-sided p-value of "no difference", runs paired by number; where some differences are infinite,
            of "as many of one sign as of the other". NaN where the runs do not say.
        adjusted: The same after Holm's correction over all differences.
    """

    estimator: str
    beams: str
    step: int
    figure: str
    runs: int
    a: float
    b: float
    change: Interval
    p: float
    adjusted: float = np.nan

    @property
    def significant(self) -> bool:
        """Whether it is more than chance."""
        return self.adjusted < LEVEL

    @property
    def is_variance(self) -> bool:
        """Whether tables show the root of it."""
        return self.figure.startswith(("mse_", "claimed_"))

    @property
    def ratio(self) -> Interval:
        """B over A, with the interval of their difference over A; of roots where tables show those."""
        if not (math.isfinite(self.a) and math.isfinite(self.b) and self.a > 0):
            return Interval(math.nan, math.nan, math.nan)
        ends = [max(1 + change / self.a, 0.0) for change in self.change]
        return Interval(*(math.sqrt(end) if self.is_variance else end for end in ends))

    @property
    def words(self) -> str:
        """What became of the figure from A to B."""
        if not self.runs:
            return "no run of both"
        if self.change.value == 0 and self.p == 1.0:
            return "the same"
        return ("larger" if self.b > self.a else "smaller") if self.significant else "no difference seen"

    @property
    def label(self) -> str:
        """What tables call the figure."""
        metric, component = self._of
        return metric.short_label(component) if metric else "share ok"

    @property
    def label_with_unit(self) -> str:
        """The same with the unit in which tables show it, of variances that of the root."""
        metric, component = self._of
        own = self.is_variance or (metric is not None and metric.unit == COMPONENT)
        shown = unit(component) if own else metric.unit if metric else ""
        return self.label + (f", {shown}" if shown else "")

    @property
    def shown(self) -> tuple[float, float]:
        """The figure in A and B in that unit."""
        metric, component = self._of
        if self.is_variance:
            a, b = (factor(component) * math.sqrt(end) if end >= 0 else end for end in (self.a, self.b))
            return a, b
        by = 1.0 if metric is None else metric.in_shown_unit(ONE, component).value
        return by * self.a, by * self.b

    @property
    def _of(self) -> tuple[Metric | None, str]:
        """The metric, and its component or ""; no metric for "ok"."""
        for metric in _compared():
            name, _, component = self.figure.partition(f"{_name(metric)}_")
            if self.figure == _name(metric) or (not name and component):
                return metric, component
        return None, ""


@dataclass(frozen=True)
class Comparison:
    """What differs between A and B.

    Attributes:
        config: Lines of a unified diff of the studies' texts; empty if they are the same.
        settings: Name -> (A, B), of what differs in seed, runs, versions, machine, code, threads, estimators.
        same_truths: Whether run m had the same true states in both; if not, pairing gains little.
        only_a, only_b: (estimator, beams) that the other has not.
        differences: Of what both have.
    """

    config: tuple[str, ...]
    settings: Mapping[str, tuple[Any, Any]]
    same_truths: bool
    only_a: tuple[tuple[str, str], ...]
    only_b: tuple[tuple[str, str], ...]
    differences: tuple[Difference, ...]

    def to_json(self) -> dict[str, Any]:
        """Everything, as plain values."""
        differences = [vars(each) | {"significant": each.significant} for each in self.differences]
        return vars(self) | {"differences": differences}


def compare(a: Results, b: Results) -> Comparison:
    """Compare two results, run m of one with run m of the other.

    Raises:
        ValueError: If their states have different components.
    """
    if a.space.names != b.space.names:
        raise ValueError(f"A estimates {', '.join(a.space.names)}, B {', '.join(b.space.names)}")
    pairs_a, pairs_b = (list(product(results.estimators, results.beam_sets)) for results in (a, b))
    differences = [row for pair in pairs_a if pair in pairs_b for row in _differences(a, b, *pair)]
    config_a, config_b = (results.manifest.get("config", "").splitlines() for results in (a, b))
    lines = unified_diff(config_a, config_b, lineterm="", n=0)
    return Comparison(
        config=tuple(line for line in lines if not line.startswith(("---", "+++", "@@"))),
        settings=_settings(a.manifest, b.manifest),
        same_truths=all(
            np.array_equal(a.source.world(*block)[0], b.source.world(*block)[0]) for block in _blocks(a, b)
        ),
        only_a=tuple(pair for pair in pairs_a if pair not in pairs_b),
        only_b=tuple(pair for pair in pairs_b if pair not in pairs_a),
        differences=tuple(_corrected(differences)),
    )


def what_is_not_shared(a: Results, b: Results) -> str:
    """Why two results have nothing to compare, in words; "" where an estimator and beams are in both."""
    apart = []
    for what, of_a, of_b, words in (
        ("estimator", a.estimators, b.estimators, str),
        ("set of beams", a.beam_sets, b.beam_sets, beams_in_words),
    ):
        if not {*of_a} & {*of_b}:
            has_a, has_b = (listed([*map(words, of)], MAX_LISTED) for of in (of_a, of_b))
            apart.append(f"no {what} in common (A: {has_a}; B: {has_b})")
    return " and ".join(apart)


def _blocks(a: Results, b: Results) -> Iterator[tuple[int, int]]:
    """The runs that both have, in the blocks of either."""
    runs = min(a.runs, b.runs)
    return ((first, min(end, runs)) for first, end in a.blocks() if first < runs)


def _settings(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """What differs in the manifests, by dotted name."""

    def flat(manifest: Mapping[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key in ("seed", "runs", "versions", "git", "machine", "threads", "estimators", "beam_sets"):
            value = manifest.get(key)
            parts = value.items() if isinstance(value, dict) else None
            found |= {key: value} if parts is None else {f"{key}.{name}": part for name, part in parts}
        return found

    one, other = flat(a), flat(b)
    return {
        name: (one.get(name), other.get(name)) for name in one | other if one.get(name) != other.get(name)
    }


class _Pairs:
    """Means of a figure in A and B and moments of their difference, block by block."""

    def __init__(self) -> None:
        self.count, self.a, self.b, self.apart = 0, 0.0, 0.0, Moments()

    def add(self, a: Array, b: Array) -> None:
        self.count += len(a)
        self.a += float(a.sum())
        self.b += float(b.sum())
        with np.errstate(invalid="ignore"):
            self.apart.add(np.where(a == b, 0.0, b - a))

    def difference(self, estimator: str, beams: str, step: int, figure: str) -> Difference:
        count, moments = self.count, self.apart
        a, b = (self.a / count, self.b / count) if count else (np.nan, np.nan)
        change = moments.interval(signed=True)
        return Difference(
            estimator, beams, step, figure, count, a, b, change, moments.p_value_of_no_difference()
        )


def _differences(a: Results, b: Results, estimator: str, beams: str) -> Iterator[Difference]:
    """The figures of one estimator on one set of beams, step by step."""
    pairs: dict[tuple[int, str], _Pairs] = {}
    counts = np.zeros((2, 2), dtype=int)  # by ok in A, ok in B
    for first, end in _blocks(a, b):
        trials_a, trials_b = (results.source.trials(estimator, beams, first, end) for results in (a, b))
        made = (trials_a.status != Status.PENDING.code) & (trials_b.status != Status.PENDING.code)
        np.add.at(counts, (trials_a.ok[made].astype(int), trials_b.ok[made].astype(int)), 1)
        both = trials_a.ok & trials_b.ok
        figures_a, figures_b = (
            _values(run_blocks(results, trials, first, both))
            for results, trials in ((a, trials_a), (b, trials_b))
        )
        for key in figures_a.keys() & figures_b.keys():
            pairs.setdefault(key, _Pairs()).add(figures_a[key], figures_b[key])
    total, (lost, gained) = int(counts.sum()), (int(counts[1, 0]), int(counts[0, 1]))
    well = int(counts[1].sum()), int(counts[:, 1].sum())
    shares = (well[0] / total, well[1] / total) if total else (np.nan, np.nan)
    change = Interval(shares[1] - shares[0], np.nan, np.nan)
    p = sign_test(lost, gained) if total else np.nan
    yield Difference(estimator, beams, -1, "ok", total, *shares, change, p)
    for (step, figure), pair in sorted(pairs.items()):
        yield pair.difference(estimator, beams, step, figure)


def _values(blocks: Sequence[RunBlock]) -> dict[tuple[int, str], Array]:
    """The values of runs that are compared, by step and figure."""
    return {
        (step, _name(metric) + column.removeprefix(metric.name)): values[0].astype(float)
        for step, runs in enumerate(blocks)
        for metric in _compared()
        for column, values in metric.values(runs).items()
    }


def _compared() -> list[Metric]:
    return [each for each in metrics() if "compare" in each.shown and each.average in ("mean", "share")]


def _name(metric: Metric) -> str:
    return COMPARED_AS.get(metric.name, metric.name)


def _corrected(differences: list[Difference]) -> Iterator[Difference]:
    """With Holm's p-values (S. Holm, Scand. J. Statist. 6, 1979)."""
    p = np.array([difference.p for difference in differences])
    known = np.argsort(p, kind="stable")[: np.isfinite(p).sum()]
    adjusted = np.full(len(p), np.nan)
    raised = (len(known) - np.arange(len(known))) * p[known]
    adjusted[known] = np.maximum.accumulate(np.minimum(raised, 1.0))
    return (replace(each, adjusted=float(value)) for each, value in zip(differences, adjusted, strict=True))
