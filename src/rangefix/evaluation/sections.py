"""Reads the sections of a study one by one, so that a mistake in one hides none in another."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from .mistakes import Mistakes, suggestion
from .schema import EstimatorSection, FloorPlanMap, MeshMap, RectangleMap, Section

MAPS: dict[str, type[Section]] = {"rectangle": RectangleMap, "floor-plan": FloorPlanMap, "mesh": MeshMap}


def sound_sections(model: type[BaseModel], raw: dict[str, Any], mistakes: Mistakes) -> dict[str, Any]:
    """The sections that are sound, each checked on its own, so that one mistake hides no other."""
    sections: dict[str, Any] = {}
    for key in raw.keys() - model.model_fields.keys():
        mistakes.add((key,), f"unknown key; {suggestion(key, model.model_fields)}")
    for name, entry in model.model_fields.items():
        if name not in raw:
            if entry.is_required():
                hint = entry.description or f"write a table [{name}]"
                mistakes.add((name,), f"is missing: {hint}")
            else:
                sections[name] = entry.get_default(call_default_factory=True)
        elif name == "map":
            _section(name, MAPS.get(_kind(raw[name], mistakes)), raw[name], sections, mistakes)
        elif name == "estimators" and isinstance(raw[name], list) and raw[name]:
            checked: dict[str, Any] = {}
            for place, each in enumerate(raw[name]):
                _section(place, EstimatorSection, each, checked, mistakes, at=(name,))
            sections[name] = list(checked.values())
        elif isinstance(entry.annotation, type) and issubclass(entry.annotation, BaseModel):
            _section(name, entry.annotation, raw[name], sections, mistakes)
        else:
            try:
                kind: Any = Annotated[entry.annotation, entry]
                adapter: TypeAdapter[Any] = TypeAdapter(kind, config=Section.model_config)
                sections[name] = adapter.validate_python(raw[name])
            except ValidationError as error:
                mistakes.add_all(error, (name,), raw[name], None)
    return sections


def _kind(raw: Any, mistakes: Mistakes) -> str:
    """The kind of map; "" with a mistake noted if there is no such kind."""
    if not isinstance(raw, dict):
        mistakes.add(("map",), 'must be a table [map] with, for example, kind = "rectangle"')
    elif "kind" not in raw:
        mistakes.add(("map", "kind"), f"is missing: one of {', '.join(MAPS)}")
    elif raw["kind"] not in MAPS:
        mistakes.add(("map", "kind"), f"no kind {raw['kind']!r}; there are {', '.join(MAPS)}")
    else:
        return str(raw["kind"])
    return ""


def _section(
    name: Any,
    model: type[BaseModel] | None,
    raw: Any,
    sections: dict[Any, Any],
    mistakes: Mistakes,
    at: Any = (),
) -> None:
    if model is None:
        return
    try:
        sections[name] = model.model_validate(raw)
    except ValidationError as error:
        mistakes.add_all(error, (*at, name), raw, model)
