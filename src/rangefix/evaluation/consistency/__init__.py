"""Whether to trust it: claimed against true errors."""

from .averages import ratio_interval
from .belief_scores import RANK_DRAWS, belief_arrays, judge_belief, rank_histogram
from .calibration import Curve, Reliability, coverage_curve, curve, histogram, pit, reliability, uniform_band
from .compare import Comparison, Difference
from .formatting import (
    beams_in_words,
    capital,
    factor,
    format_factor,
    format_interval,
    format_number,
    format_percent_interval,
    scaled,
    unit,
    visible,
)
from .from_arrays import coverage, credibility, noncredibility
from .gates import Gate, GateLine, check_gates, need_sound, parse_gates
from .intervals import Interval, mean_interval, share_interval, uniform_p_value
from .metrics import METRICS, Metric, RunBlock
from .normalised import anees_band, is_positive, nees
from .row import Row, to_csv
from .verdict import ALARMS, CERTAIN, LARGE_FACTOR, Kind, Verdict, decide, decide_overall, is_overconfident
