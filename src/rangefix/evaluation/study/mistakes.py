"""Mistakes of a study file as lines that name the key, say what is wrong, and how to fix it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, time
from difflib import get_close_matches
from itertools import islice
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ...errors import one_line, printable, suggestion
from .sections.base import Misfit, Misfits, kinds_of, misfits_of
from .toml_lines import Path, line_of

T = TypeVar("T")
MOST_SHOWN = 200  # letters of a wrong value
MOST_LOOKED_AT = 100  # mistakes whose cause is looked for
MOST_TOLD = 20  # mistakes; more are counted
FORMS = {  # what pydantic calls a mistake -> what we say
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "finite_number": "must be a finite number",
    "too_short": "needs at least {min_length} of them",
    "too_long": "takes no more than {max_length} of them",
    "literal_error": "must be {expected}",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} letters",
    "string_pattern_mismatch": "names a folder: no slashes, and not dots alone",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_unicode": "holds a byte that is no UTF-8: rename it",
    "string_type": "must be a text in quotation marks",
    "list_type": "must be a list",
    "bool_type": "must be true or false",
    "dict_type": "must be a table of keys",
    "model_type": "must be a table of keys",
    "model_attributes_type": "must be a table of keys",
}


class StudyError(ValueError):
    """A study that cannot be run; `mistakes` holds one line for each thing to fix."""

    def __init__(self, mistakes: Sequence[str]) -> None:
        super().__init__("\n".join(mistakes))
        self.mistakes = list(mistakes)

    def __reduce__(self) -> tuple[type[StudyError], tuple[list[str]]]:
        """So that it crosses processes."""
        return StudyError, (self.mistakes,)


@dataclass
class Mistakes:
    """Collects the mistakes of a study.

    Attributes:
        source: What the file is called.
        lines: Key -> the line where it stands.
        typed: Keys that were given instead of the file's -> how: an option, and what it was given.
        noted: Key and line of text of each mistake.
        misspelt: Keys that are missing as others stand for them, which mistakes are told of.
    """

    source: str
    lines: dict[Path, int] = field(default_factory=dict)
    typed: dict[Path, str] = field(default_factory=dict)
    noted: list[tuple[Path, str]] = field(default_factory=list)
    misspelt: list[Path] = field(default_factory=list)

    def add(self, path: Path, text: str) -> None:
        """Note a mistake at a key; () for the whole file."""
        self.noted.append((path, self.line(path, text)))

    def line(self, path: Path, text: str) -> str:
        """What is to be said of a key, with the place where it stands."""
        if path in self.typed:
            return printable(f"{self.typed[path]}: {text}")
        line = line_of(path, self.lines)
        where = f"{self.source}:{line}" if line else self.source
        name = dotted(path)
        return printable(f"{where}: {name}: {text}" if name else f"{where}: {text}")

    def sound(self, *path: str | int) -> bool:
        """Whether there is no mistake at a key, around it or within it."""
        wrong = [*self.misspelt, *(other for other, _ in self.noted)]
        return not any(all(a == b for a, b in zip(path, other, strict=False)) for other in wrong)

    def attempt(self, at: Path, build: Callable[[], T]) -> T | None:
        """What is built; None, and its mistake noted, if it cannot be."""
        try:
            return build()
        except ValueError as error:
            if not isinstance(error, Misfit | Misfits):
                self.add(at, one_line(error))
            for misfit in misfits_of(error):
                self.add((*at, *misfit.path), one_line(misfit))
        return None

    def add_all(self, error: ValidationError, raw: dict[str, Any], model: type[BaseModel]) -> None:
        """Note what pydantic found in the keys of a study; what [assumed] inherits is told once."""
        faults = error.errors(include_url=False)
        places = [_place(fault, raw, model) for fault in faults]
        misspelt = {
            (*fault["loc"][:-1], meant)
            for fault, (_, inner) in islice(zip(faults, places, strict=True), MOST_LOOKED_AT)
            if fault["type"] == "extra_forbidden"
            for meant in get_close_matches(str(fault["loc"][-1]), _keys(inner), n=1)
        }  # fmt: skip
        told: list[tuple[Path, str]] = []
        told_of: list[Any] = []  # the faults themselves
        for fault, (path, inner) in zip(faults, places, strict=True):
            form = "float_type" if isinstance(fault["input"], list) else "list_type"
            if fault["type"] == form and sum(other[: len(path)] == path for other, _ in places) > 1:
                continue  # the other form that the key might have had
            if fault["type"] == "missing" and fault["loc"] in misspelt:
                self.misspelt.append(path)
                continue  # the unknown key says so
            if fault["type"].startswith("union_tag") and len(path) == 1 + (path[0] == "assumed"):
                path = (*path, "kind")
            text = _sentence(fault, path, inner) if len(told) < MOST_LOOKED_AT else str(fault["msg"])
            misfits = misfits_of(fault.get("ctx", {}).get("error"))
            told += [((*path, *misfit.path), misfit.text) for misfit in misfits] or [(path, text)]
            told_of += [fault] * max(1, len(misfits))
        for (path, text), fault in zip(told, told_of, strict=True):
            if fault["type"] == "extra_forbidden" and self.typed.get(path, "").startswith("--"):
                self.noted.append((path, f"{self.typed[path]} has no effect on {self._map()}"))
            elif path[0] != "assumed" or (path[1:], text) not in told:
                self.add(path, text)

    def _map(self) -> str:
        """The map, as it was given."""
        return printable(self.typed.get(("map",), "the map of this study").removeprefix("--map "))

    def check(self) -> None:
        """Raise StudyError if there is any mistake."""
        if self.noted:
            noted = sorted(self.noted, key=lambda mistake: line_of(mistake[0], self.lines) or 0)
            texts = list(dict.fromkeys(text for _, text in noted))
            more = [f"{self.source}: and {len(texts) - MOST_TOLD} more"] * (len(texts) > MOST_TOLD)
            raise StudyError(texts[:MOST_TOLD] + more)


def dotted(path: Path) -> str:
    """A key as people write it: sensor.std_m, estimators[2].options; places count from 1."""
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _place(error: Any, raw: Any, model: type[BaseModel]) -> tuple[Path, type[BaseModel]]:
    """The key where a mistake is, and the model that has it; pydantic names types and kinds in between."""
    path: Path = ()
    kinds: Mapping[str, type[BaseModel]] = {}
    *around, last = error["loc"]
    for part in around:
        if part in kinds:
            model, kinds = kinds[part], {}
        elif part in model.model_fields:
            kinds = kinds_of(model.model_fields[part])
            model = kinds.get("", model)
        if _holds(raw, part):
            path, raw = (*path, part), raw[part]
    return (*path, last) if _holds(raw, last) or error["type"] == "missing" else path, model


def as_typed(value: Any) -> str:
    """A value as a study has it, where Python writes truth values and dates otherwise."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, date | time):
        return str(value)
    if isinstance(value, list):
        return f"[{', '.join(map(as_typed, value))}]"
    return repr(value)


def _holds(raw: Any, part: Any) -> bool:
    return part in (raw if isinstance(raw, dict) else range(len(raw)) if isinstance(raw, list) else ())


def _keys(model: type[BaseModel]) -> list[str]:
    """The keys of a section as a file has them."""
    return [entry.alias or name for name, entry in model.model_fields.items()]


def _sentence(error: Any, path: Path, model: type[BaseModel]) -> str:
    """What is wrong and how to fix it."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    fields = model.model_fields
    key = next((part for part in reversed(error["loc"]) if part in fields), "")
    hint = fields[key].description if key else None
    kinds = kinds_of(fields[key]) if key else {}
    example = f" ({hint})" if hint else ""
    if kind == "extra_forbidden":
        return f"unknown key; {suggestion(str(path[-1]), _keys(model))}"
    if kind == "missing":
        return f"is missing: {hint}" if len(path) == 1 else f"is missing{example}"
    if kind == "value_error":
        return str(context["error"])
    if kind == "union_tag_invalid":
        return f"no kind '{context['tag']}'; there are {', '.join(kinds)}"
    if kind == "union_tag_not_found":
        return f"{'is missing:' if path[-1] == 'kind' else 'needs a kind,'} one of {', '.join(kinds)}"
    if kind == "list_type" and isinstance(value, dict):
        return "must be a list: write it as [[TABLE]], with two brackets, for there may be many"
    if kind.startswith("model") and path == ("assumed",):
        return "must be tables, for example [assumed.sensor]"
    if kind.startswith("model") and all(isinstance(part, str) for part in path):
        first = next(iter(kinds), "")
        example = f' with, for example, kind = "{first}"' if first else ""
        return f"must be a table [{dotted(path)}]{example}"
    said = FORMS[kind].format(**context) if kind in FORMS else str(error["msg"])
    shown = as_typed(value)
    return f"{said}, got {shown if len(shown) <= MOST_SHOWN else shown[:MOST_SHOWN] + '...'}{example}"
