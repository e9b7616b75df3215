"""Whether to trust it: claimed against true errors."""

from .belief_scores import DRAWS, belief_arrays, judge_belief, rank_histogram
from .calibration import Curve, Reliability, coverage_curve, curve, histogram, pit, reliability, uniform_band
from .compare import Comparison, Difference
from .formatting import (
    capital,
    factor,
    measured,
    name_beams,
    percent_interval,
    scaled,
    short,
    times,
    unit,
    visible,
)
from .from_arrays import coverage, credibility, noncredibility
from .gates import Gate, GateLine, check_gates, need_sound, parse_gates
from .intervals import Interval, mean_interval, ratio_interval, share_interval, uniform_p_value
from .normalised import anees_band, is_positive, nees
from .row import Row, to_csv
from .verdict import ALARMS, CERTAIN, MUCH, Kind, Verdict, decide, decide_overall, overconfident

__all__ = [
    "ALARMS",
    "CERTAIN",
    "DRAWS",
    "MUCH",
    "Comparison",
    "Curve",
    "Difference",
    "Gate",
    "GateLine",
    "Interval",
    "Kind",
    "Reliability",
    "Row",
    "Verdict",
    "anees_band",
    "belief_arrays",
    "capital",
    "check_gates",
    "coverage",
    "coverage_curve",
    "credibility",
    "curve",
    "decide",
    "decide_overall",
    "factor",
    "histogram",
    "is_positive",
    "judge_belief",
    "mean_interval",
    "measured",
    "name_beams",
    "need_sound",
    "nees",
    "noncredibility",
    "overconfident",
    "parse_gates",
    "percent_interval",
    "pit",
    "rank_histogram",
    "ratio_interval",
    "reliability",
    "scaled",
    "share_interval",
    "short",
    "times",
    "to_csv",
    "uniform_band",
    "uniform_p_value",
    "unit",
    "visible",
]
