"""What may stand in a study file as a JSON schema, by which editors complete keys and mark mistakes.

`study.schema.json` beside this module holds it; to write it anew, run
`python -m rangefix.evaluation.study.editor_schema`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .schema import StudySections

FILE = Path(__file__).with_name("study.schema.json")
TOLD_ELSEWHERE = ("kind", "path")  # by the other keys; by --map
ASSUMED = "AssumedSection"


def editor_schema() -> dict[str, Any]:
    """The schema of study files, with the sections that come along.

    It lets through what reading a file fills in: the kind of a section, the path of a map that the command
    line gives, and under [assumed] all keys that are those of the true section. Reading a study checks more
    than a schema can.
    """
    schema = StudySections.model_json_schema()
    sections: dict[str, Any] = schema["$defs"]
    assumed = sections.pop(ASSUMED)
    partial = {f"Assumed{name}": _renamed(_without_required(section)) for name, section in sections.items()}
    for section in sections.values():
        section["required"] = [key for key in section.get("required", []) if key not in TOLD_ELSEWHERE]
    loosened: dict[str, Any] = _loosened(
        {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            **schema,
            "title": "A study of rangefix",
            "$defs": {**sections, ASSUMED: _renamed(assumed), **partial},
        }
    )
    return loosened


def _without_required(section: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in section.items() if key != "required"}


def _renamed(part: Any) -> Any:
    """The same with references to the sections whose keys may all be left out."""
    if isinstance(part, dict):
        return {
            key: value.replace("#/$defs/", "#/$defs/Assumed") if key == "$ref" else _renamed(value)
            for key, value in part.items()
        }
    return [*map(_renamed, part)] if isinstance(part, list) else part


def _loosened(part: Any) -> Any:
    """The same without discriminators, since the kind that they go by may be left out."""
    if isinstance(part, dict):
        plain = {key: _loosened(value) for key, value in part.items() if key != "discriminator"}
        if isinstance(plain.get("oneOf"), list):
            plain["anyOf"] = plain.pop("oneOf")
        return plain
    return [*map(_loosened, part)] if isinstance(part, list) else part


def as_text() -> str:
    """The schema as its file has it."""
    return json.dumps(editor_schema(), indent=1) + "\n"


if __name__ == "__main__":
    FILE.write_text(as_text(), encoding="utf-8")
