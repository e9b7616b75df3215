"""The scores of a report: of each Gaussian claim and, where beliefs were sampled, of the belief itself."""

from __future__ import annotations

from .intervals import Interval, uniform_p_value
from .report_data import Digest
from .report_html import Child, Html, tag
from .report_words import measured, percent, scaled
from .summary import Row
from .units import factor, unit
from .verdict import name_beams, short

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


def scores(digest: Digest) -> Html:
    """All settings after the last measurement."""
    rows = [setting.row for setting in digest.settings.values()]
    sampled = any(row.beliefs is not None for row in rows)
    columns = _columns(rows[0].names, sampled)
    bodies = []
    for beams in digest.results.beam_sets:
        group = tag("th", name_beams(beams), colspan=len(columns), scope="rowgroup")
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
    columns = ["estimator", "log score, nats", "energy score, m"]
    columns += [f"CRPS of {name}, {unit(name)}" for name in names]
    if sampled:
        columns += [f"std of {name}, {unit(name)}: whole belief / main mode" for name in names]
        columns += ["share of the main mode", "ranks, p"]
    return columns


def _row(row: Row, columns: list[str], sampled: bool) -> Html:
    claim, beliefs = row.scores, row.beliefs
    cells: list[Child] = [measured(claim.log), _both(claim.energy, beliefs and beliefs.energy)]
    for i, k in enumerate(map(factor, row.names)):
        belief = scaled(beliefs.crps[i], k) if beliefs else None
        cells.append(_both(scaled(claim.crps[i], k), belief))
    if beliefs is not None:
        for i, k in enumerate(map(factor, row.names)):
            whole, mode = (short(k * each[i].sqrt().value) for each in (beliefs.whole, beliefs.mode))
            cells.append(f"{whole} / {mode}")
        p = uniform_p_value(beliefs.ranks[-1])
        cells += [percent(beliefs.share), f"{p:.2g}" if p == p else "-"]
    elif sampled:
        cells += ["-"] * (len(row.names) + 2)
    return tag(
        "tr",
        tag("th", row.estimator, scope="row"),
        (tag("td", cell, data_label=name) for cell, name in zip(cells, columns[1:], strict=True)),
    )


def _both(claim: Interval, belief: Interval | None) -> Html:
    """The score of the claim, and small beneath it that of the belief."""
    small = None if belief is None else tag("small", f"belief {measured(belief)}")
    return tag("span", f"{'claim ' if belief else ''}{measured(claim)}", small, class_="stacked")
