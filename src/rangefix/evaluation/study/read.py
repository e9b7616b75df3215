"""Reads the sections of a study one by one, so that a mistake in one hides none in another."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from ...errors import suggestion
from .mistakes import Mistakes
from .sections import (
    CentredPrior,
    ConstantVelocityMotion,
    EstimatorSection,
    FloorPlanMap,
    MeshMap,
    MixturePrior,
    OdometryMotion,
    RandomWalkMotion,
    RectangleMap,
    Section,
    SensorSection,
    StateSection,
    StationaryMotion,
    UniformPrior,
)

KINDS: dict[str, dict[str, type[Section]]] = {
    "map": {"rectangle": RectangleMap, "floor-plan": FloorPlanMap, "mesh": MeshMap},
    "motion": {
        "stationary": StationaryMotion,
        "random-walk": RandomWalkMotion,
        "constant-velocity": ConstantVelocityMotion,
        "odometry": OdometryMotion,
    },
    "prior": {"uniform": UniformPrior, "gaussian": CentredPrior, "mixture": MixturePrior},
}
DEFAULT_KINDS = {"motion": "stationary", "prior": "uniform"}
ASSUMED: dict[str, type[Section] | None] = {
    "state": StateSection, "sensor": SensorSection, "motion": None, "prior": None
}  # fmt: skip
# Of these keys those in the true section are left out where one is in the assumed section.
INSTEAD: dict[str, tuple[set[str], ...]] = {
    "sensor": ({"std_m", "noise"}, {"bearings_deg", "resolution_deg"}),
    "prior": ({"lower_m", "upper_m", "size_m"}, {"parts", "weights"}),
}
OF_THE_DRIVE = ("steps", "waypoints_m", "step_m", "turn_deg", "clearance_m", "start_m", "drive_seed")
# These are taken from a true section of another kind.
COMMON = ("steps", "confined", "tries", "heading_deg", "heading_std_deg", "velocity_m_per_s",
          "velocity_std_m_per_s")  # fmt: skip


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
        elif name in KINDS:
            _section(name, _of_kind(name, raw[name], mistakes, (name,)), raw[name], sections, mistakes)
        elif name == "assumed":
            checked = _assumed(raw, mistakes)
            if checked is not None:
                sections[name] = entry.annotation(**checked)  # type: ignore[misc]
        elif name == "estimators" and isinstance(raw[name], list) and raw[name]:
            found: dict[str, Any] = {}
            for place, each in enumerate(raw[name]):
                _section(place, EstimatorSection, each, found, mistakes, at=(name,))
            sections[name] = list(found.values())
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


def _of_kind(name: str, raw: Any, mistakes: Mistakes, at: tuple[str, ...]) -> type[Section] | None:
    """The model of a section that has kinds; None with a mistake noted if there is no such kind."""
    kinds = KINDS[name]
    if not isinstance(raw, dict):
        mistakes.add(at, f'must be a table [{".".join(at)}] with, for example, kind = "{next(iter(kinds))}"')
        return None
    kind = raw.get("kind", DEFAULT_KINDS.get(name))
    if kind is None:
        mistakes.add((*at, "kind"), f"is missing: one of {', '.join(kinds)}")
    elif kind not in kinds:
        mistakes.add((*at, "kind"), f"no kind {kind!r}; there are {', '.join(kinds)}")
    return kinds.get(kind) if isinstance(kind, str) else None


def _assumed(raw: Mapping[str, Any], mistakes: Mistakes) -> dict[str, Any] | None:
    """What estimators are told otherwise than it is: keys not given are those of the true section."""
    given = raw["assumed"]
    if not isinstance(given, dict):
        mistakes.add(("assumed",), "must be tables, for example [assumed.sensor]")
        return None
    checked: dict[str, Any] = {}
    for name, section in given.items():
        at = ("assumed", name)
        if name not in ASSUMED:
            mistakes.add(at, f"unknown key; {suggestion(name, ASSUMED)}")
            continue
        if not isinstance(section, dict):
            mistakes.add(at, f"must be a table [assumed.{name}]")
            continue
        if name == "motion" and (wrong := [key for key in OF_THE_DRIVE if key in section]):
            for key in wrong:
                mistakes.add((*at, key), "the drive is that of [motion]: leave it out")
            continue
        true = raw.get(name, {})
        merged = _merged(name, true if isinstance(true, dict) else {}, section)
        model = ASSUMED[name] or _of_kind(name, merged, mistakes, at)
        inherited = merged.keys() - section.keys()  # mistakes in these are noted where they stand
        _section(name, model, merged, checked, mistakes, ("assumed",), inherited)
    return checked


def _merged(name: str, true: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    default = DEFAULT_KINDS.get(name)
    kept = set(true)
    if given.get("kind", true.get("kind", default)) != true.get("kind", default):
        kinds = KINDS[name]
        model = kinds.get(given["kind"]) if isinstance(given["kind"], str) else None
        kept &= set(COMMON) & set(model.model_fields if model else ())
    for group in INSTEAD.get(name, ()):
        if group & given.keys():
            kept -= group
    return {key: value for key, value in true.items() if key in kept} | given


def _section(
    name: Any,
    model: type[BaseModel] | None,
    raw: Any,
    sections: dict[Any, Any],
    mistakes: Mistakes,
    at: Any = (),
    ignored: Collection[str] = (),
) -> None:
    if model is None:
        return
    try:
        sections[name] = model.model_validate(raw)
    except ValidationError as error:
        mistakes.add_all(error, (*at, name), raw, model, ignored)
