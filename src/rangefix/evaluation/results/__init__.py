"""What a study yields, in memory and in a folder."""

from ...arrays import Array
from .belief_images import FILE, Picture, load_pictures
from .files import ResultsError, digest, read_part, sweep, write_bytes, write_json, write_npz, write_part
from .folder import MANIFEST, TIMING, Plan, part_arrays, read_timing, trials_path, whole, world_path
from .map_snapshot import Scene, scene
from .outcome import FAILURES, PREFIX, STATUSES, BeliefScores, Outcome, blank, joined, judged
from .results import MOST, Results, load
from .trials import Source, Trials

__all__ = [
    "FAILURES",
    "FILE",
    "MANIFEST",
    "MOST",
    "PREFIX",
    "STATUSES",
    "TIMING",
    "Array",
    "BeliefScores",
    "Outcome",
    "Picture",
    "Plan",
    "Results",
    "ResultsError",
    "Scene",
    "Source",
    "Trials",
    "blank",
    "digest",
    "joined",
    "judged",
    "load",
    "load_pictures",
    "part_arrays",
    "read_part",
    "read_timing",
    "scene",
    "sweep",
    "trials_path",
    "whole",
    "world_path",
    "write_bytes",
    "write_json",
    "write_npz",
    "write_part",
]
