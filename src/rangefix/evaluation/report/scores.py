"""The scores of a report: of each Gaussian claim and, where beliefs were sampled, of the belief itself."""

from __future__ import annotations

from ..consistency import Interval, Row, beams_in_words, factor, format_number, scaled, uniform_p_value, unit
from .badges import stacked
from .data import ReportData
from .html import Child, Html, tag

SMALLEST_P_VALUE_SHOWN = 1e-6  # p-value that is told
SCORES = (
    "Lower is better, also for the logarithm. A score judges what is claimed as a whole, over all "
    "runs{}: \u201cclaim\u201d is the Gaussian with the claimed mean and covariance, \u201cbelief\u201d what "
    "the estimator believes, whatever its shape, where it was sampled."
)
BELIEFS = (
    " Beside the spread of the whole belief stands that of its main mode, the cloud that holds most of it. "
    "The last column is the p-value of the truth having every rank equally often among samples, in order of "
    "their distance from the middle: small if the belief is wrong, whatever its shape."
)


def scores(digest: ReportData) -> Html:
    """All settings after the last measurement."""
    rows = [setting.row for setting in digest.settings.values()]
    sampled = any(row.beliefs is not None for row in rows)
    columns = _columns(rows[0].names, sampled)
    bodies = []
    for beams in digest.results.beam_sets:
        group = tag("th", beams_in_words(beams), colspan=len(columns), scope="rowgroup")
        some = [
            _row(digest.settings[estimator, beams].row, columns, sampled)
            for estimator in digest.results.estimators
        ]
        bodies.append(tag("tbody", tag("tr", group, class_="group"), some))
    head = tag("tr", (tag("th", each, scope="col") for each in columns))
    after = f" after the last of {digest.steps} measurements" if digest.steps > 1 else ""
    return tag(
        "section",
        tag("h2", "Scores"),
        tag("p", SCORES.format(after), BELIEFS if sampled else None, class_="fine"),
        tag("div", tag("table", tag("thead", head), bodies), class_="scroll"),
        id="scores",
    )


def _columns(names: tuple[str, ...], sampled: bool) -> list[str]:
    both = ": claim / belief" if sampled else ""
    columns = ["estimator", f"log score{' of the claim' if sampled else ''}, nats", f"energy score, m{both}"]
    columns += [f"CRPS of {name}, {unit(name)}{both}" for name in names]
    if sampled:
        columns += [f"std of {name}, {unit(name)}: whole belief / main mode" for name in names]
        columns += ["share of the main mode", "ranks, p"]
    return columns


def _row(row: Row, columns: list[str], sampled: bool) -> Html:
    claim, found, factors = row.scores, row.beliefs, [factor(name) for name in row.names]
    pairs = [(claim.energy, found and found.energy, 1.0)]
    pairs += [(each, found and found.crps[i], factors[i]) for i, each in enumerate(claim.crps)]
    cells: list[Child] = [stacked(claim.log), *(_score(*pair, sampled) for pair in pairs)]
    if found is not None:
        for k, whole, mode in zip(factors, found.whole, found.mode, strict=True):
            cells.append(f"{format_number(k * whole.sqrt().value)} / {format_number(k * mode.sqrt().value)}")
        cells += [f"{100 * found.share.value:.3g} %", _p_value(uniform_p_value(found.ranks[-1]))]
    elif sampled:
        cells += ["-"] * (len(row.names) + 2)
    return tag(
        "tr",
        tag("th", row.estimator, scope="row"),
        (tag("td", cell, data_label=name) for cell, name in zip(cells, columns[1:], strict=True)),
    )


def _score(claim: Interval, belief: Interval | None, k: float, sampled: bool) -> Child:
    """The score of the claim with its interval or, where beliefs are sampled, beside that of the belief."""
    if not sampled:
        return stacked(scaled(claim, k))
    value = format_number(k * claim.value) if claim.value == claim.value else "-"
    return f"{value} / {format_number(k * belief.value) if belief else '-'}"


def _p_value(p: float) -> str:
    if p != p:
        return "-"
    return f"{p:.2g}" if p >= SMALLEST_P_VALUE_SHOWN else f"< {SMALLEST_P_VALUE_SHOWN:g}"
