"""What a study yields, in memory and in a folder. Names are loaded when they are first asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy_names import offered_by

if TYPE_CHECKING:
    from .belief_images import FILE, Picture, load_pictures
    from .draws import (
        KEPT_DRAWS,
        HalfArray,
        Whitening,
        keep_draws,
    )
    from .files import (
        ResultsError,
        hash_of,
        read_json,
        remove,
        remove_partial_files,
        write_bytes,
        write_json,
    )
    from .folder import (
        BOUNDS,
        FIGURES,
        LOCK,
        MANIFEST,
        REPORT,
        SCENE,
        SUMMARY,
        TIMING,
        WORST_RUNS,
        FolderLayout,
        runs_of_part,
        trials_path,
        world_path,
    )
    from .map_snapshot import Scene, scene
    from .notebook import html_table
    from .npz import (
        read_npz,
        read_part,
        write_npz,
        write_part,
    )
    from .outcome import (
        CORRELATION_ROUNDING,
        FAILURES,
        PREFIX,
        STATUSES,
        BeliefScores,
        Outcome,
        Status,
        concatenate,
        failed_outcome,
        failures_of,
        fault_of,
        is_finite,
        is_symmetric,
        with_status,
    )
    from .parts import (
        Part,
        if_valid,
        outcome_of,
        part_arrays,
        read_if_valid,
        read_trials,
        read_world,
    )
    from .results import (
        MAX_RUNS_IN_MEMORY,
        Results,
        load,
        read_timing,
    )
    from .saved_bounds import SavedBounds, read_bounds
    from .trials import InMemory, Source, Trials

_MODULES = {
    "belief_images": ("FILE", "Picture", "load_pictures"),
    "draws": ("KEPT_DRAWS", "HalfArray", "Whitening", "keep_draws"),
    "files": (
        "ResultsError",
        "hash_of",
        "read_json",
        "remove",
        "remove_partial_files",
        "write_bytes",
        "write_json",
    ),
    "folder": (
        "BOUNDS",
        "FIGURES",
        "LOCK",
        "MANIFEST",
        "REPORT",
        "SCENE",
        "SUMMARY",
        "TIMING",
        "WORST_RUNS",
        "FolderLayout",
        "runs_of_part",
        "trials_path",
        "world_path",
    ),
    "map_snapshot": ("Scene", "scene"),
    "notebook": ("html_table",),
    "npz": ("read_npz", "read_part", "write_npz", "write_part"),
    "outcome": (
        "CORRELATION_ROUNDING",
        "FAILURES",
        "PREFIX",
        "STATUSES",
        "BeliefScores",
        "Outcome",
        "Status",
        "concatenate",
        "failed_outcome",
        "failures_of",
        "fault_of",
        "is_finite",
        "is_symmetric",
        "with_status",
    ),
    "parts": ("Part", "if_valid", "outcome_of", "part_arrays", "read_if_valid", "read_trials", "read_world"),
    "results": ("MAX_RUNS_IN_MEMORY", "Results", "load", "read_timing"),
    "saved_bounds": ("SavedBounds", "read_bounds"),
    "trials": ("InMemory", "Source", "Trials"),
}  # module -> what it offers
__getattr__, __dir__ = offered_by(__name__, _MODULES)
