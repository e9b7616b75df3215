"""A file with a table [sensor], as `rangefix calibrate` writes it: noise and place of a recording's laser."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import ValidationError

from ...evaluation.recordings.options import ReadingOptions
from ...evaluation.study.sections.sensor import SensorSection
from ...filters import Noise


@dataclass(frozen=True)
class SensorFile:
    """What a file says of the laser.

    Attributes:
        options: How the recording is read, with the place of the laser.
        noise: How readings scatter, as filters are told; None = the file does not say.
        law: How they scatter together: with the errors that readings share.
    """

    options: ReadingOptions
    noise: Noise | None = None
    law: Noise | None = None


def read_sensor(path: Path, options: ReadingOptions) -> SensorFile:
    """Noise and place of the laser of a file with a table [sensor]; what the command line says comes first.

    Where there is a table [assumed.sensor], as `rangefix calibrate` writes it, that is what filters are told,
    and [sensor] is what readings are held against to say whether a filter is lost.

    Raises:
        ValueError: If there is no such table, or it is not sound.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        table = document["sensor"] | document.get("assumed", {}).get("sensor", {})  # what filters are told
        section, true = (
            SensorSection.model_validate({"bearings_deg": [0.0], **each})
            for each in (table, document["sensor"])
        )
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror or error}") from None
    except (KeyError, TypeError, AttributeError):
        raise ValueError(f"{path} has no table [sensor]") from None
    except ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(map(str, fault["loc"]))
        raise ValueError(f"{path}, [sensor] {where}: {fault['msg']}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    placed = {"forward_m", "left_m", "yaw_deg"} & set(table)
    told = {name: getattr(section, name) for name in placed if getattr(options, name) is None}
    return SensorFile(replace(options, **told), section.build_noise(), true.build_noise())
