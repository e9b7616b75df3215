"""The sections of a report: title, verdicts, table, failures, provenance."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from ..consistency import ALARMS, beams_in_words, capital, factor, format_interval, format_number, unit
from ..results import FAILURES
from .badges import badge, colour, stacked
from .data import ReportData, Setting
from .html import Child, Html, tag

REASONS = 8  # that are listed for one estimator
FINE = (
    "A factor is ANEES / n: how many times larger squared errors are than the claimed variances. An exact "
    "filter is accused in at most {:.0f} % of studies, counting all its sets of beams and steps."
)
TABLE = (
    "True and claimed standard deviations{}: root of G and of the mean P, over the runs that went well. The "
    "energy score judges the claim of the position as a whole, taken as a Gaussian: lower is better."
)


def heading(digest: ReportData) -> Html:
    """Title, and what was done."""
    manifest = digest.results.manifest
    name = manifest.get("name") or "study"
    last = [setting.row for setting in digest.settings.values()]
    ok, planned = sum(row.ok for row in last), sum(row.planned for row in last)
    facts = [
        f"{digest.results.runs} runs",
        f"{len(digest.results.estimators)} estimator{'s' * (len(digest.results.estimators) != 1)}",
        f"{len(digest.results.beam_sets)} set{'s' * (len(digest.results.beam_sets) != 1)} of beams",
        f"{digest.steps} measurement{'s' * (digest.steps != 1)} a run",
        f"seed {manifest.get('seed', 'unknown')}",
        f"{ok} of {planned} trials went well",
    ]
    notes = []
    if manifest.get("state") != "complete":
        notes.append(
            tag("p", "This study was interrupted: what follows counts what was finished.", class_="warning")
        )
    return tag(
        "header",
        tag("p", "rangefix: may the claimed covariances be trusted?", class_="kicker"),
        tag("h1", manifest.get("title") or name),
        tag("ul", (tag("li", fact) for fact in facts), class_="facts"),
        notes,
    )


def verdicts(digest: ReportData) -> Html:
    """First of all: whom to trust."""
    found = {name: digest.overall(name) for name in digest.results.estimators}
    honest = [name for name, verdict in found.items() if verdict.kind == "honest"]
    severe = [name for name, verdict in found.items() if verdict.severe]
    unsure = [name for name, verdict in found.items() if verdict.kind == "unsure"]
    lead: list[Child] = []
    if honest:
        lead.append(["Honest: ", _names(honest), ". "])
    if severe:
        lead.append(["Do not trust: ", _names(severe), ". "])
    if unsure:
        lead.append(["Not settled by these runs: ", _names(unsure), ". "])
    if not lead:
        lead.append("None is honest throughout, and none is far off.")
    cards = [
        tag(
            "article",
            tag("h3", name),
            badge(verdict),
            tag("p", capital(verdict.words), class_="words"),
            tag("p", f"ANEES / n {format_interval(verdict.factor)}", class_="factor")
            if verdict.kind != "failed"
            else None,
            tag("ul", (tag("li", capital(note)) for note in verdict.notes)) if verdict.notes else None,
            class_=f"card {colour(verdict)}",
        )
        for name, verdict in found.items()
    ]
    fine = FINE.format(100 * ALARMS)
    return tag(
        "section",
        tag("h2", "Verdict"),
        tag("p", lead, class_="lead"),
        tag("div", cards, class_="cards"),
        gates(digest),
        tag("p", fine, class_="fine"),
        id="verdict",
    )


def _names(names: Sequence[str]) -> list[Child]:
    parts: list[Child] = []
    for name in names:
        parts += [", " if parts else None, tag("strong", name)]
    return parts


def gates(digest: ReportData) -> Html | None:
    """What became of the gates, if there were any."""
    if not digest.lines:
        return None
    failed = sum(not line.passed for line in digest.lines)
    state = f"{failed} of {len(digest.lines)} failed" if failed else f"all {len(digest.lines)} passed"
    shown = [tag("li", line.text, class_="pass" if line.passed else "fail") for line in digest.lines]
    return tag("div", tag("h3", f"Gates: {state}"), tag("ul", shown, class_="gates"), class_="gate-box")


def table(digest: ReportData) -> Html:
    """All settings after the last measurement."""
    names = digest.results.space.names
    columns = [
        "estimator",
        "ok",
        *(f"std of {name}, {unit(name)}: true / claimed" for name in names),
        "ANEES / n",
        "energy score, m",
        "ms per update",
        "verdict",
    ]
    bodies = []
    for beams in digest.results.beam_sets:
        group = tag("th", beams_in_words(beams), colspan=len(columns), scope="rowgroup")
        rows = [
            _table_row(digest.settings[estimator, beams], columns) for estimator in digest.results.estimators
        ]
        bodies.append(tag("tbody", tag("tr", group, class_="group"), rows))
    head = tag("tr", (tag("th", each, scope="col") for each in columns))
    after = f" after the last of {digest.steps} measurements" if digest.steps > 1 else ""
    return tag(
        "section",
        tag("h2", "Table"),
        tag("p", TABLE.format(after), class_="fine"),
        tag("div", tag("table", tag("thead", head), bodies), class_="scroll"),
        id="table",
    )


def _table_row(setting: Setting, columns: Sequence[str]) -> Html:
    row = setting.row
    pairs = [
        f"{format_number(k * g.sqrt().value)} / {format_number(k * p.sqrt().value)}" if row.ok else "-"
        for g, p, k in zip(row.g, row.p, map(factor, row.names), strict=True)
    ]
    seconds = format_number(1e3 * row.seconds) if math.isfinite(row.seconds) else "-"
    cells: list[Child] = [
        row.ok if row.ok == row.planned else f"{row.ok} of {row.planned}",
        *pairs,
        stacked(row.anees),
        stacked(row.scores.energy),
        seconds,
    ]
    labels = [name.removeprefix("std of ") for name in columns[1:-1]]
    found = setting.verdict
    said = None if found.kind in ("honest", "overconfident", "cautious") else found.words
    return tag(
        "tr",
        tag("th", row.estimator, scope="row"),
        (tag("td", cell, data_label=name) for cell, name in zip(cells, labels, strict=True)),
        tag(
            "td", badge(found, factor=True), tag("p", said, class_="said") if said else None, class_="verdict"
        ),
    )


def failures(digest: ReportData) -> Html:
    """What went wrong, how often and why."""
    bad = digest.failures
    if not bad:
        text = "None: every planned trial gave an answer."
        return tag("section", tag("h2", "Failures"), tag("p", text), id="failures")
    head = tag("tr", (tag("th", each, scope="col") for each in ("estimator", "beams", *FAILURES)))
    rows = [
        tag(
            "tr",
            tag("th", each.estimator, scope="row"),
            tag("td", beams_in_words(each.beams), data_label="beams"),
            (tag("td", each.counts.get(name, 0), data_label=name) for name in FAILURES),
        )
        for each in bad
    ]
    return tag(
        "section",
        tag("h2", "Failures"),
        tag("p", "Trials that failed are in no average above.", class_="fine"),
        tag("div", tag("table", tag("thead", head), tag("tbody", rows)), class_="scroll"),
        [_reasons(digest, name) for name in dict.fromkeys(each.estimator for each in bad)],
        id="failures",
    )


def _reasons(digest: ReportData, estimator: str) -> list[Html]:
    mine = [each.reasons for each in digest.failures if each.estimator == estimator]
    counts = sum(mine, Counter[str]())
    listed = [
        tag("li", tag("b", f"{count} \u00d7 "), tag("code", reason))
        for reason, count in counts.most_common(REASONS)
    ]
    if len(counts) > REASONS:
        listed.append(tag("li", f"and {len(counts) - REASONS} other reasons"))
    return [tag("h3", estimator), tag("ul", listed, class_="reasons")]


def provenance(digest: ReportData) -> Html:
    """Where the numbers come from, and how to have them again."""
    manifest = digest.results.manifest
    git = manifest.get("git") or {}
    machine = manifest.get("machine") or {}
    code = (
        f"{git.get('commit', '')}{' with local changes' if git.get('dirty') else ''}"
        if git
        else "no checkout"
    )
    versions = manifest.get("versions") or {}
    threads = manifest.get("threads") or {}
    facts = {
        "command": " ".join(map(str, manifest.get("command_line") or [])) or "from Python",
        "date": manifest.get("date", ""),
        "seed": manifest.get("seed", ""),
        "rangefix": versions.get("rangefix", ""),
        "commit": code,
        "libraries": ", ".join(f"{name} {each}" for name, each in versions.items() if name != "rangefix"),
        "processor": f"{machine.get('cpu', '')}, {machine.get('cores', '')} cores",
        "system": machine.get("system", ""),
        "threads": ", ".join(f"{name}={each}" for name, each in threads.items() if each)
        or "as the libraries choose",
    }
    config = manifest.get("config")
    return tag(
        "section",
        tag("h2", "Provenance"),
        tag(
            "dl",
            (tag("div", tag("dt", name), tag("dd", value)) for name, value in facts.items()),
            class_="origin",
        ),
        tag("details", tag("summary", "The study as it was run"), tag("pre", config)) if config else None,
        id="provenance",
    )
