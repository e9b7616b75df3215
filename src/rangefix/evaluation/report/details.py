"""The charts of a report, and its details estimator by estimator."""

from __future__ import annotations

from collections.abc import Iterable

from ..consistency import (
    CERTAIN,
    METRICS,
    beams_in_words,
    capital,
    decide,
    factor,
    format_interval,
    format_number,
    format_percent_interval,
    scaled,
    unit,
)
from .badges import badge, colour
from .charts import Lane, Mark, Scale, coverage_panel, histogram_panel, lanes, reliability_panel, steps_chart
from .data import ReportData, Setting
from .html import Child, Html, tag

KEYS = {
    "Coverage": "How many truths lie inside the ellipses of each level. A belief that is no Gaussian may "
    "leave the diagonal and be honest.",
    "PIT, ranks": "Where the truth lies in the claimed Gaussian of a component, or among samples of the "
    "belief. Flat if honest: ranks for any shape of the belief, PIT if it is Gaussian. A hump is caution, "
    "high ends are overconfidence.",
    "Reliability": "Root mean squared error of runs that claim about the same. Above the diagonal they "
    "claim too little.",
}


def charts(digest: ReportData) -> Html:
    """Claimed against true, and ANEES / n, of all settings on common axes."""
    settings = digest.settings
    ends = [min(end, CERTAIN) for each in settings.values() for end in each.row.anees]
    scale = Scale.over(ends, 0.4, 2.5)
    grouped = [
        (
            beams_in_words(beams),
            [
                Lane(
                    name,
                    [Mark(settings[name, beams].row.anees, colour(settings[name, beams].verdict))],
                    format_interval(settings[name, beams].row.anees),
                )
                for name in digest.results.estimators
            ],
        )
        for beams in digest.results.beam_sets
    ]
    parts = [
        tag("h2", "Charts"),
        tag("h3", "ANEES / n: squared error over claimed variance"),
        tag(
            "p",
            "1 is honest; to the right the errors are larger than claimed. Bars are 95 % intervals; the "
            "shaded zone is within a factor of 1.5.",
            class_="fine",
        ),
        lanes(grouped, scale, "ANEES / n", honest=True),
    ]
    for i, name in enumerate(digest.results.space.names):
        parts += _deviations(digest, i, name)
    return tag("section", parts, id="charts")


def _deviations(digest: ReportData, i: int, name: str) -> list[Html]:
    settings = digest.settings
    ends = [
        factor(name) * end
        for each in settings.values()
        for end in (*each.row.g[i].sqrt(), each.row.p[i].sqrt().value)
        if end == end and end > 0
    ]
    if not ends:
        return []
    scale = Scale.over(ends, min(ends), max(ends))
    grouped = []
    for beams in digest.results.beam_sets:
        some = []
        for estimator in digest.results.estimators:
            row = settings[estimator, beams].row
            true, claimed = (scaled(each.sqrt(), factor(name)) for each in (row.g[i], row.p[i]))
            figure = f"{format_number(true.value)} / {format_number(claimed.value)}" if row.ok else "-"
            some.append(Lane(estimator, [Mark(claimed, "claimed"), Mark(true, "true")], figure))
        grouped.append((beams_in_words(beams), some))
    key = tag(
        "p",
        tag("span", class_="key true"),
        " true: root of G",
        tag("span", class_="key claimed"),
        " claimed: root of mean P",
        class_="fine keys",
    )
    shown = unit(name)
    return [
        tag("h3", f"Standard deviation of {name}, {shown}"),
        key,
        lanes(grouped, scale, f"{shown}: true / claimed"),
    ]


def details(digest: ReportData) -> Html:
    """Estimator by estimator."""
    return tag(
        "section",
        tag("h2", "Estimators one by one"),
        tag(
            "dl",
            (tag("div", tag("dt", name), tag("dd", text)) for name, text in KEYS.items()),
            class_="legend",
        ),
        [_detail(digest, name) for name in digest.results.estimators],
        id="estimators",
    )


def _detail(digest: ReportData, estimator: str) -> Html:
    overall = digest.overall(estimator)
    described = digest.results.manifest.get("estimators", {}).get(estimator, {})
    options = ", ".join(f"{key} = {value}" for key, value in (described.get("options") or {}).items())
    built = described.get("name") or described.get("builder") or estimator
    sets = [digest.settings[estimator, beams] for beams in digest.results.beam_sets]
    return tag(
        "details",
        tag("summary", tag("span", estimator, class_="summary-name"), badge(overall)),
        tag(
            "p", "Built as ", tag("code", built), f" with {options}" if options else " with its defaults", "."
        ),
        [_setting(digest, setting) for setting in sets],
        open="open" if len(digest.results.estimators) == 1 else None,
    )


def _setting(digest: ReportData, setting: Setting) -> Html:
    row = setting.row
    found = setting.verdict
    parts: list[Child] = [
        tag("h4", beams_in_words(row.beams)),
        tag("p", badge(found), " ", capital(found.words), " ", (capital(note) + " " for note in found.notes)),
    ]
    if row.ok:
        if digest.steps > 1:
            mine = [each for each in digest.rows_of(row.estimator) if each.beams == row.beams]
            kinds = [colour(decide(each)) for each in mine]
            parts += [
                tag("h5", "ANEES / n after each measurement"),
                steps_chart([r.anees for r in mine], kinds),
            ]
        parts.append(tag("div", _panels(setting), class_="panels"))
        parts.append(tag("div", _facts(setting), class_="numbers"))
    return tag("div", parts, class_="setting")


def _panels(setting: Setting) -> Iterable[Html]:
    curves = setting.coverage()
    both = " (dashed: of the sampled belief)" if len(curves) > 1 else ""
    yield coverage_panel(f"Coverage, %{both}", curves)
    for i, name in enumerate(setting.row.names):
        counts, ranks = setting.histogram(i)
        yield histogram_panel(f"{'Ranks' if ranks else 'PIT'} of {name}", counts, "ranks" if ranks else "pit")
        yield reliability_panel(f"Reliability of {name}, {unit(name)}", setting.reliability(i), unit(name))


def _facts(setting: Setting) -> Iterable[Html]:
    row, scores, beliefs = setting.row, setting.row.scores, setting.row.beliefs
    pairs: list[tuple[str, str]] = []
    for i, name in enumerate(row.names):
        pairs.append((f"G / P of {name} (1 = honest)", format_interval(row.ratio[i])))
        pairs.append(
            (f"mean error of {name}, {unit(name)}", format_interval(scaled(row.bias[i], factor(name))))
        )
        pairs.append(
            (
                f"CRPS of {name}, {unit(name)} (Gaussian claim)",
                format_interval(scaled(scores.crps[i], factor(name))),
            )
        )
    pairs += [
        ("ANEES / n", format_interval(row.anees)),
        ("NCI, dB", format_interval(row.nci)),
        ("inclination, dB", format_interval(row.inclination)),
        ("energy score of the position, m (Gaussian claim)", format_interval(scores.energy)),
        ("log score, nats (Gaussian claim at the truth; lower is better)", format_interval(scores.log)),
        ("log evidence, nats (of the measurements; higher is better)", format_interval(scores.evidence)),
    ]
    pairs += [
        (f"inside the {100 * level:g} % ellipse", format_percent_interval(share))
        for level, share in row.coverage.items()
    ]
    if row.indefinite.value > 0:
        pairs.append(("covariance not positive definite", format_percent_interval(row.indefinite)))
    if row.improbable.value > 0:
        pairs.append(("improbable measurements", format_percent_interval(row.improbable)))
    if beliefs is not None:
        pairs.append(("energy score of the position, m (sampled belief)", format_interval(beliefs.energy)))
        pairs.append(("mean share of the main mode", format_percent_interval(beliefs.share)))
        for i, name in enumerate(row.names):
            k, shown = factor(name), unit(name)
            pairs.append(
                (f"CRPS of {name}, {shown} (sampled belief)", format_interval(scaled(beliefs.crps[i], k)))
            )
            whole, mode = (format_number(k * each[i].sqrt().value) for each in (beliefs.whole, beliefs.mode))
            pairs.append((f"std of {name}, {shown}: whole belief / main mode", f"{whole} / {mode}"))
    for metric, component, interval in row.shown("report"):
        if metric not in METRICS:  # of another package
            value = format_interval(metric.in_shown_unit(interval, component))
            pairs.append((metric.full_label(component), value))
    for label, value in pairs:
        yield tag("div", tag("dt", label), tag("dd", value))
