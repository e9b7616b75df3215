"""Mistakes of a study file as lines that name the key, say what is wrong, and how to mend it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from ...errors import suggestion
from .sections import Misfit
from .toml_lines import Path, line_of


class StudyError(ValueError):
    """A study that cannot be run; `mistakes` holds one line for each thing to mend."""

    def __init__(self, mistakes: Sequence[str]) -> None:
        super().__init__("\n".join(mistakes))
        self.mistakes = list(mistakes)

    def __reduce__(self) -> tuple[type[StudyError], tuple[list[str]]]:
        """So that it crosses processes."""
        return StudyError, (self.mistakes,)


@dataclass
class Mistakes:
    """Collects mistakes; `lines` tells where keys stand, `given` which keys the caller overrode."""

    source: str
    lines: dict[Path, int] = field(default_factory=dict)
    given: frozenset[Path] = frozenset()
    found: list[tuple[int, str]] = field(default_factory=list)

    def add(self, path: Path, text: str) -> None:
        """Note a mistake at a key; () for the whole file."""
        self.found.append((line_of(path, self.lines) or 0, self.line(path, text)))

    def line(self, path: Path, text: str) -> str:
        """What is to be said of a key, with the place where it stands."""
        line = line_of(path, self.lines)
        where = f"{self.source}:{line}" if line else self.source
        if path in self.given:
            where = "command line"
        name = dotted(path)
        return f"{where}: {name}: {text}" if name else f"{where}: {text}"

    def add_all(
        self,
        error: ValidationError,
        at: Path,
        raw: Any,
        model: type[BaseModel] | None,
        ignored: Collection[str] = (),
    ) -> None:
        """Note what pydantic found in a section, but for keys that are ignored."""
        found = [
            each
            for each in error.errors(include_url=False)
            if each["loc"][:1] not in {(key,) for key in ignored}
        ]
        misspelt = {
            (*each["loc"][:-1], close) for each in found if each["type"] == "extra_forbidden"
            for close in get_close_matches(str(each["loc"][-1]), _names(model, each["loc"]), n=1)
        }  # fmt: skip
        for each in found:
            path = _real_path(each, raw)
            same = [other for other in found if _real_path(other, raw)[: len(path)] == path]
            form = "float_type" if isinstance(each["input"], list) else "list_type"
            if len(same) > 1 and each["type"] == form:
                continue  # the other form that the key might have had
            if each["type"] == "missing" and each["loc"] in misspelt:
                continue  # the unknown key says so
            if isinstance(misfit := each.get("ctx", {}).get("error"), Misfit):
                path = (*path, *misfit.path)
            self.add((*at, *path), _sentence(each, path, innermost(model, each["loc"])))

    def check(self) -> None:
        """Raise StudyError if there is any mistake."""
        if self.found:
            lines = [text for _, text in sorted(self.found, key=lambda pair: pair[0])]
            raise StudyError(list(dict.fromkeys(lines)))


def dotted(path: Path) -> str:
    """A key as people write it: sensor.std_m, estimators[2].options; places count from 1."""
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _real_path(error: Any, raw: Any) -> Path:
    """Where a mistake is, without the names of types and kinds that pydantic puts in between."""
    path: Path = ()
    parts, missing = list(error["loc"]), error["type"] == "missing"
    for i, part in enumerate(parts):
        inside = (
            part in raw
            if isinstance(raw, dict)
            else part in range(len(raw))
            if isinstance(raw, list)
            else False
        )
        if inside:
            raw = raw[part]
        elif i < len(parts) - 1 or not missing:
            continue
        path = (*path, part)
    return path


def innermost(model: type[BaseModel] | None, loc: Sequence[int | str]) -> type[BaseModel] | None:
    """The model that the last part of a location is a key of: pydantic names the kinds on the way."""
    kinds: dict[str, type[BaseModel]] = {}
    for part in loc[:-1]:
        if part in kinds:
            model, kinds = kinds[str(part)], {}
        elif model is not None and part in model.model_fields:
            kinds = _kinds(model.model_fields[str(part)].annotation)
    return model


def _names(model: type[BaseModel] | None, loc: Sequence[int | str]) -> Iterable[str]:
    """The keys that might stand at the end of a location."""
    inner = innermost(model, loc)
    return inner.model_fields if inner else ()


def _kinds(annotation: Any) -> dict[str, type[BaseModel]]:
    """The models in a type, by the kinds that they stand for."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        kind = annotation.model_fields.get("kind")
        return {str(name): annotation for name in get_args(kind.annotation)} if kind else {}
    return {name: found for each in get_args(annotation) for name, found in _kinds(each).items()}


def _sentence(error: Any, path: Path, model: type[BaseModel] | None) -> str:
    """What is wrong and how to mend it."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    fields = model.model_fields if model else {}
    key = next((part for part in reversed(path) if isinstance(part, str)), "")
    hint = fields[key].description if key in fields else None
    example = f" ({hint})" if hint else ""
    if kind == "extra_forbidden":
        names = [entry.alias or name for name, entry in fields.items()]
        return f"unknown key; {suggestion(str(path[-1]), names)}"
    if kind == "missing":
        return f"is missing{example}"
    if kind == "value_error":
        return str(context["error"])
    bounds = {
        "greater_than": "must be greater than {gt:g}",
        "greater_than_equal": "must be at least {ge:g}",
        "less_than": "must be less than {lt:g}",
        "finite_number": "must be a finite number",
        "too_short": "needs at least {min_length} of them",
        "too_long": "takes no more than {max_length} of them",
        "literal_error": "must be {expected}",
        "string_too_short": "must not be empty",
        "float_type": "must be a number",
        "int_type": "must be a whole number",
        "string_type": "must be a text in quotation marks",
        "list_type": "must be a list",
        "bool_type": "must be true or false",
        "model_type": "must be a table of keys",
        "model_attributes_type": "must be a table of keys",
        "union_tag_not_found": "needs a kind, one of {kinds}",
        "union_tag_invalid": "no kind '{tag}'; there are {kinds}",
        "less_than_equal": "must be at most {le:g}",
        "dict_type": "must be a table of keys",
        "string_pattern_mismatch": "names a folder: no slashes, and not dots alone",
    }
    if kind == "list_type" and isinstance(value, dict):
        return "must be a list: write it as [[TABLE]], with two brackets, for there may be many"
    if kind.startswith("union_tag"):
        kinds = _kinds(fields[key].annotation) if key in fields else {}
        return bounds[kind].format(**context, kinds=", ".join(kinds))
    text = bounds.get(kind)
    return (text.format(**context) if text else str(error["msg"])) + f", got {value!r}{example}"
