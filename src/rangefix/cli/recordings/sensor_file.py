"""A file with a table [sensor], as `rangefix calibrate` writes it: noise and place of a recording's laser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from ...arrays import wrap
from ...errors import suggestion
from ...evaluation.recordings.log import LaserDescription
from ...evaluation.recordings.options import ReadingOptions
from ...evaluation.study.mistakes import Mistakes
from ...evaluation.study.read import inherited, read_toml
from ...evaluation.study.schema import AssumedSection
from ...evaluation.study.sections.base import Section
from ...evaluation.study.sections.sensor import SensorSection
from ...evaluation.study.study import Study
from ...evaluation.study.toml_lines import key_lines
from ...filters import Noise
from ...text_files import NotText, read_text

BEAMS = {"bearings_deg", "resolution_deg", "blind_sector_deg"}
PLACE = {"forward_m", "left_m", "yaw_deg"}
CLOSE = 1e-3  # deg, and the share of a range, to which a file's values are those of a log


class AssumedSensor(Section):
    """What filters are told."""

    sensor: SensorSection


class SensorTables(Section):
    """What is looked at of a file."""

    sensor: SensorSection
    assumed: AssumedSensor


@dataclass(frozen=True)
class SensorFile:
    """What a file says of the laser.

    Attributes:
        options: How the recording is read, with the place of the laser.
        noise: How readings scatter, as filters are told; None = the file does not say.
        law: How they scatter together: with the errors that readings share.
        true: The table [sensor], which `law` is of; None where there is no file.
        section: What filters are told; None where there is no file.
        given: The keys of it that stand in the file.
        others: Tables and keys of a study that a replay does not use.
        mistakes: Knows the file and its lines.
    """

    options: ReadingOptions
    noise: Noise | None = None
    law: Noise | None = None
    true: SensorSection | None = None
    section: SensorSection | None = None
    given: frozenset[str] = frozenset()
    others: tuple[str, ...] = ()
    mistakes: Mistakes = field(default_factory=lambda: Mistakes(""))

    def notes(self, laser: LaserDescription) -> Iterator[str]:
        """What of the file is not used, a sentence each.

        Args:
            laser: As the log describes it; what a file says as the log does needs no words.
        """
        if self.section is None:
            return
        unused = [name for name in sorted(self.given) if not self._agrees(name, laser)]
        for names, why in (
            (unused, "the log says what counts"),
            (self.others, "a replay takes noise and place of the laser from the file"),
        ):
            if names:
                verb = "is" if len(names) == 1 else "are"
                yield f"{self.mistakes.source}: {', '.join(names)} {verb} not used: {why}"

    def _agrees(self, name: str, laser: LaserDescription) -> bool:
        """Whether a key of the file is used, or says what the log says."""
        assert self.section is not None
        if name in BEAMS:
            off = np.abs(wrap(self.section.bearings[:, None] - laser.bearings_rad))
            return bool((off.min(axis=1) < np.deg2rad(CLOSE)).all())
        if name == "max_range_m":
            return bool(np.isclose(self.section.max_range_m, laser.reach_m, rtol=CLOSE))
        if name == "min_range_m":
            return bool(np.isclose(self.section.min_range_m, laser.range_min_m, rtol=CLOSE))
        return True

    def check_beams(self, used: int, total: int) -> None:
        """Refuse noise with numbers for other beams than those that are used, or than all of the laser.

        Raises:
            ValueError: If there are so many, or so few.
        """
        for table, section in ((("sensor",), self.true), (("assumed", "sensor"), self.section)):
            if section is None:
                continue
            around = table if section.noise is None else (*table, "noise")
            for name, value in _noise_values(section):
                if isinstance(value, list) and len(value) not in (used, total):
                    line = self.mistakes.line((*around, name), f"has {len(value)} values for {used} beams")
                    raise ValueError(line.replace(f"{name}: has", f"{name} has"))


def read_sensor(path: Path, options: ReadingOptions) -> SensorFile:
    """Noise and place of the laser of a file with a table [sensor]; what the command line says comes first.

    Where there is a table [assumed.sensor], as `rangefix calibrate` writes it, that is what filters are told,
    and [sensor] is what readings are held against to say whether a filter is lost.

    Raises:
        ValueError: If there is no such table, or it is not sound: a line for each mistake.
    """
    try:
        text = read_text(path)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror or error}") from None
    except NotText as error:
        raise ValueError(f"{path}: {error}") from None
    document = read_toml(text, str(path))
    mistakes = Mistakes(str(path), key_lines(text))
    others = tuple(_others(document, mistakes))
    mistakes.check()
    if not isinstance(document.get("sensor"), dict):
        raise ValueError(f"{path} has no table [sensor]")
    told = document.get("assumed", {}).get("sensor", {})
    table = inherited("sensor", document["sensor"], told)
    raw = {"sensor": _with_beams(document["sensor"]), "assumed": {"sensor": _with_beams(table)}}
    try:
        tables = SensorTables.model_validate(raw)
    except ValidationError as error:
        mistakes.add_all(error, raw, SensorTables)
        mistakes.check()
        raise
    section, given = tables.assumed.sensor, frozenset(table)
    placed = {name: getattr(section, name) for name in PLACE & given if getattr(options, name) is None}
    noise, law = section.build_noise(), tables.sensor.build_noise()
    if "max_incidence_deg" in given:
        others = (*others, "sensor.max_incidence_deg")
    options = replace(options, **placed)
    return SensorFile(options, noise, law, tables.sensor, section, given, others, mistakes)


def _others(document: dict[str, Any], mistakes: Mistakes) -> Iterator[str]:
    """Tables and keys of a study that are not looked at; unknown ones are mistakes."""
    known = Study.model_fields
    for name, value in document.items():
        if name not in known:
            mistakes.add((name,), f"unknown key; {suggestion(name, ('sensor', 'assumed'))}")
        elif name == "assumed":
            if not isinstance(value, dict):
                mistakes.add((name,), "must be tables, for example [assumed.sensor]")
                continue
            for inner in value:
                if inner not in AssumedSection.model_fields:
                    mistakes.add((name, inner), f"unknown key; {suggestion(inner, ('sensor',))}")
                elif inner != "sensor":
                    yield f"assumed.{inner}"
        elif name != "sensor":
            yield name


def _with_beams(table: Any) -> Any:
    """A table with beams where it has none: as many as its noise has numbers for, since a log has its own."""
    if not isinstance(table, dict) or {"bearings_deg", "resolution_deg"} & table.keys():
        return table
    noise = table.get("noise")
    values = [table.get("std_m"), *(noise.values() if isinstance(noise, dict) else ())]
    count = next((len(value) for value in values if isinstance(value, list) and value), 1)
    return {"bearings_deg": [0.0] * count} | table


def _noise_values(section: SensorSection) -> Iterator[tuple[str, Any]]:
    """The keys that say how readings scatter, with their values."""
    if section.noise is None:
        yield "std_m", section.std_m
    else:
        yield from section.noise
