"""How good anybody could be, saved beside the results of the same study, whose tables show it then."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..bounds.catalogue import Row
from ..bounds.document import document_of
from ..consistency.row import to_csv
from ..consistency.summarise import summarise
from ..experiment import Experiment
from ..results import BOUNDS, MANIFEST, SUMMARY, load, read_json, write_bytes, write_json
from .keys import part_keys
from .own_folder import locked


def is_of(folder: Path, experiment: Experiment) -> bool:
    """Whether a folder holds finished results of an experiment: of the same truths, by the same version.

    Raises:
        ResultsError: If it holds damaged results.
    """
    if not (folder / MANIFEST).exists():
        return False
    found = load(folder).manifest
    complete = found["state"] == "complete" and list(found["beam_sets"]) == list(experiment.beam_labels)
    return complete and found["plan"]["world"] == part_keys(experiment)[0]


def save_bounds(folder: Path, experiment: Experiment, rows: Sequence[Row]) -> Path:
    """Save what was computed for an experiment beside its results, and write their summary anew.

    Args:
        folder: Finished results of the experiment: see `is_of`.
        experiment: The experiment.
        rows: All entries, of all its sets of beams.

    Returns:
        The file written.

    Raises:
        ResultsError: If it is in use, or cannot be written.
    """
    with locked(folder):
        world = read_json(folder / MANIFEST)["plan"]["world"]
        write_json(folder / BOUNDS, document_of(rows, experiment, world))
        write_bytes(folder / SUMMARY, to_csv(summarise(load(folder))).encode())
    return folder / BOUNDS
