"""What a study yields, in memory and in a folder."""

from .belief_images import FILE, Picture, load_pictures
from .files import (
    ResultsError,
    hash_of,
    read_part,
    remove_partial_files,
    write_bytes,
    write_json,
    write_npz,
    write_part,
)
from .folder import (
    MANIFEST,
    TIMING,
    FolderLayout,
    part_arrays,
    read_if_valid,
    read_timing,
    trials_path,
    world_path,
)
from .map_snapshot import Scene, scene
from .notebook import html_table
from .outcome import (
    FAILURES,
    PREFIX,
    STATUSES,
    BeliefScores,
    Outcome,
    Status,
    concatenate,
    failed_outcome,
    failures_of,
    with_status,
)
from .results import MAX_RUNS_IN_MEMORY, Results, load
from .trials import Source, Trials
