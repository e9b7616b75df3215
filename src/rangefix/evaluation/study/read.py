"""Reads study files: fills in the kinds and the keys that are inherited, then validates the whole once."""

from __future__ import annotations

import re
import tomllib
from ast import literal_eval
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ...errors import one_line, printable, suggestion
from ...maps import MapError
from ...maps.readers import is_map_file, is_plan, kind_of, map_table
from ...text_files import NotText, read_text
from .build import build_world
from .check_estimators import refuse_plugins
from .mistakes import Mistakes, StudyError
from .sections.base import Section, kinds_of
from .study import Study
from .toml_lines import MOST_DEEP, deep_line, key_lines
from .toml_lines import Path as Key

EXAMPLES = Path(__file__).parent / "examples"
MOST_BYTES = 2 << 20  # of a study file
MOST_NAME = 60  # letters of a key that are shown
SOUND: dict[str, Any] = {  # stand where there are mistakes, and are not looked at
    "map": {"kind": "rectangle", "width_m": 1.0, "length_m": 1.0},
    "sensor": {"bearings_deg": [0.0], "std_m": 1.0},
    "estimators": [{"name": "none"}],
}


def study_names() -> tuple[str, ...]:
    """Names of the studies that come with the package."""
    return tuple(sorted(file.stem for file in EXAMPLES.glob("*.toml")))


def load_study(
    target: str | Path,
    *,
    runs: int | None = None,
    seed: int | None = None,
    map_path: str | Path | None = None,
    map_keys: Mapping[str, Any] | None = None,
    plugins: bool = True,
    given_as: Mapping[str, str] | None = None,
) -> Study:
    """Read a study and check it whole, but for the code of plug-ins, none of which is run.

    Args:
        target: A path to a TOML file, or the name of a study that comes with the package.
        runs, seed: Instead of the file's.
        map_path: A map file, or a room as "room:WIDTHxLENGTH", instead of the file's [map]; its keys that fit
            the new map are kept. A path counts from the current folder.
        map_keys: Keys of [map] instead of the file's, such as unit = "inch"; None as a value changes nothing.
        plugins: Whether it may name estimators that are not built in.
        given_as: What mistakes call `runs`, `seed` and `map`, such as "--runs"; these names unless given.

    Raises:
        StudyError: With every mistake of the file, one line each.
    """
    path = Path(target)
    if path.suffix != ".toml" and str(target) in study_names():
        path = EXAMPLES / f"{target}.toml"
    try:
        if path.exists() and not path.is_file():
            raise StudyError([f"{target}: is no file"])
        if path.stat().st_size > MOST_BYTES:
            if _is_called_map(path):
                raise StudyError([_is_map(target, given_as)])
            raise StudyError(
                [f"{target}: has more than {MOST_BYTES} bytes: put a large map in a file of its own"]
            )
        text = read_text(path)
    except FileNotFoundError:
        raise StudyError([f"{target}: no such file{_meant(path)}"]) from None
    except NotText as error:
        if _is_called_map(path):
            raise StudyError([_is_map(target, given_as)]) from None
        none = "" if path.suffix == ".toml" else "is no study, which is a .toml file: "
        raise StudyError([f"{target}: {none}{error}"]) from None
    except OSError as error:
        raise StudyError([f"{target}: cannot be read: {error.strerror or one_line(error)}"]) from None
    if _holds_map(path, text):
        raise StudyError([_is_map(target, given_as)])
    changes = {"runs": runs, "seed": seed, "map": map_path and str(map_path)}
    return parse_study(
        text,
        source=path.name,
        folder=path.parent,
        changes=changes,
        map_keys=map_keys,
        plugins=plugins,
        given_as=given_as,
    )


def _holds_map(path: Path, text: str) -> bool:
    """Whether a file that should be a study is a map: a plan in TOML, or no TOML and called as maps are."""
    try:
        return is_plan(read_toml(text, path.name))
    except StudyError:  # which is told when it is read as a study
        return _is_called_map(path)


def _is_called_map(path: Path) -> bool:
    """Whether files so called are maps and never studies."""
    return path.suffix != ".toml" and is_map_file(path)


def _is_map(target: str | Path, given_as: Mapping[str, str] | None) -> str:
    """What is said of a map where a study is asked for."""
    option = (given_as or {}).get("map", "map_path")
    return f"{target}: is a map and no study: name a study, and the map by {option} or in the study's [map]"


def _meant(path: Path) -> str:
    """Which study was meant by a file that is not there, or which come along."""
    beside = [str(file) for file in path.parent.glob("*.toml")] if path.parent.is_dir() else []
    hint = suggestion(str(path), [*study_names(), *beside])
    if hint.startswith("did you mean"):
        return f"; {hint}"
    return f"; studies that come along: {', '.join(study_names())}"


def parse_study(
    text: str,
    *,
    source: str = "study",
    folder: Path = Path(),
    changes: Mapping[str, Any] | None = None,
    map_keys: Mapping[str, Any] | None = None,
    plugins: bool = True,
    given_as: Mapping[str, str] | None = None,
) -> Study:
    """A study from the text of its file, checked as by `load_study`.

    Args:
        text: TOML.
        source: What mistakes call the file; without its ending, the study's name unless the text has one.
        folder: Where relative paths count from.
        changes: Key -> value instead of the file's; None changes nothing. A map is named by its path or as
            "room:WIDTHxLENGTH"; keys of [map] that fit the new map are kept.
        map_keys: Keys of [map] instead of the file's; None as a value changes nothing.
        plugins: Whether it may name estimators that are not built in.
        given_as: What mistakes call the keys of `changes`; as they are called unless given.

    Raises:
        StudyError: With every mistake, one line each.
    """
    raw = {"name": Path(source).stem} | read_toml(text, source)
    changed = {key: value for key, value in (changes or {}).items() if value is not None}
    typed: dict[Key, str] = {(key,): (given_as or {}).get(key, key) for key in changed}
    mistakes = Mistakes(source, key_lines(text), typed)
    if "map" in changed:
        typed["map",] += f" {changed['map']}"
        told = mistakes.attempt(("map",), lambda: _given_map(str(changed["map"]))) or SOUND["map"]
        if "path" in told:
            told["path"] = str(Path(told["path"]).absolute())
        typed |= {("map", key): typed["map",] for key in told}
        changed["map"] = inherited("map", raw.get("map"), told)
    keys = {key: value for key, value in (map_keys or {}).items() if value is not None}
    if keys:
        typed |= {("map", key): (given_as or {}).get(key, key) for key in keys}
        section = changed.get("map", _with_kind("map", raw.get("map", {})))
        changed["map"] = section | keys if isinstance(section, dict) else section
    study = _validated(_filled(raw | changed, mistakes), mistakes)
    study._folder, study._places = folder, mistakes
    if not plugins:
        refuse_plugins(study.estimators, mistakes)
    world = build_world(study, mistakes)
    mistakes.check()
    notes = "".join(f"# given on the command line: {key} = {value!r}\n" for key, value in changed.items())
    study._text, study._world = notes + text, world
    return study


def read_toml(text: str, source: str) -> dict[str, Any]:
    """The keys of a TOML text.

    Args:
        text: The text.
        source: Where it is from, for messages.

    Raises:
        StudyError: If it is no TOML that can be read, with the line where that is known.
    """
    if (deep := deep_line(text)) is not None:
        raise StudyError([_too_deep(source, deep, text)])
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise StudyError([_not_toml(source, error)]) from None
    except (RecursionError, ValueError) as error:  # quoted names nest too; numbers of thousands of digits
        raise StudyError([f"{source}: not TOML that can be read: {one_line(error)}"]) from None


def _not_toml(source: str, error: tomllib.TOMLDecodeError) -> str:
    """The mistake, with the line where others have it."""
    text = one_line(error).replace("Cannot overwrite a value", "this key stands twice")
    if table := re.match(r"Cannot (mutate|\w+)[a-z ]* (\(['\"].*\))( twice)? \(at ", text):
        name = printable(".".join(literal_eval(table[2])))
        told = "is written in full already" if table[1] == "mutate" else "stands twice"
        text = f"[{name}] {told} {text[table.end() - 4 :]}"
    if place := re.fullmatch(r"(.*) \(at line (\d+), (column \d+)\)", text):
        return f"{source}:{place[2]}: not TOML: {place[1]} ({place[3]})"
    return f"{source}: not TOML: {text}"


def _too_deep(source: str, line: int, text: str) -> str:
    """The mistake, with the key on whose line it is."""
    start = text.split("\n")[line - 1].lstrip("[ ")
    key = start.partition("=")[0].strip()
    key = key if len(key) <= MOST_NAME else f"{key[:MOST_NAME]}..."
    return f"{source}:{line}: {key}: names, lists or tables lie more than {MOST_DEEP} deep in one another"


def _filled(raw: Mapping[str, Any], mistakes: Mistakes) -> dict[str, Any]:
    """The keys of a study with the kinds that a file leaves out, and with what [assumed] inherits."""
    filled: dict[str, Any] = {}
    for name, told in raw.items():
        at = ("map", "path") if isinstance(told, dict) else (name,)
        whole = mistakes.attempt(at, partial(_with_kind, name, told))
        filled[name] = SOUND["map"] if whole is None else whole
    if isinstance(raw.get("assumed"), dict):
        filled["assumed"] = {}
        for name, told in raw["assumed"].items():
            if name in SOUND and name not in raw:  # what it would inherit is missing
                continue
            true = filled.get(name, _with_kind(name, {}))
            merged = inherited(name, true, told)
            model = _model(name, merged)
            fixed = model.fixed & told.keys() if model else set[str]()
            for key in fixed:
                mistakes.add(("assumed", name, key), "the drive is that of [motion]: leave it out")
            lacks = _lacked(model, merged) - fixed - _lacked(_model(name, true), true)
            for key in lacks:
                text = f"needs {key}, and the drive is that of [motion]: write {key} there"
                mistakes.add(("assumed", name, "kind"), f"{merged['kind']} {text}")
            if not fixed | lacks:
                filled["assumed"][name] = merged
    return filled


def _lacked(model: type[Section] | None, told: Any) -> set[str]:
    """Keys that [assumed] cannot tell, and that a section must have and has not."""
    if model is None:
        return set()
    fields = model.model_fields
    return {key for key in model.fixed if key not in told and key in fields and fields[key].is_required()}


def _given_map(name: str) -> Any:
    """The section of a map that is given instead of the file's; a name without suffix may be that of no file.

    Raises:
        ValueError: If there is no such file, or its kind is unknown.
    """
    try:
        return _with_kind("map", name)
    except MapError:
        if not Path(name).suffix and "path" in map_table(name) and not Path(name).exists():
            raise ValueError("no such map file") from None
        raise


def _with_kind(name: str, told: Any) -> Any:
    """A section with its kind where that is left out: the file of a map tells it, or there is a usual one."""
    if name == "map" and isinstance(told, str):
        told = map_table(told)
    if not isinstance(told, dict) or "kind" in told or name not in Study.model_fields:
        return told
    if name == "map" and isinstance(told.get("path"), str):
        return {"kind": kind_of(told["path"])} | told
    kind = getattr(Study.model_fields[name].default, "kind", None)
    return {"kind": kind} | told if kind else told


def _model(name: str, told: Any) -> type[Section] | None:
    """What a section is to be, by its kind."""
    if not isinstance(told, dict) or name not in Study.model_fields:
        return None
    return kinds_of(Study.model_fields[name]).get(str(told.get("kind", "")))


def inherited(name: str, true: Any, told: Any) -> Any:
    """A section of which some keys are told anew: the others stay, as far as its kind has them too."""
    if not isinstance(true, dict) or not isinstance(told, dict):
        return told
    told = {key: true[key] for key in ("kind",) if key in true} | told
    model, other = _model(name, told), _model(name, true)
    if model is None or other is None:
        return told
    kept = true
    if model is not other:
        shared = next(base for base in model.mro() if issubclass(base, Section) and issubclass(other, base))
        kept = {key: value for key, value in true.items() if key in shared.model_fields}
    anew = [keys for keys in model.alternatives if keys & told.keys()]
    return {key: value for key, value in kept.items() if not any(key in keys for keys in anew)} | told


def _validated(raw: dict[str, Any], mistakes: Mistakes) -> Study:
    """The study, if need be with sound sections in the place of those with mistakes, which are noted."""
    try:
        return Study.model_validate(raw)
    except ValidationError as error:
        mistakes.add_all(error, raw, Study)
        wrong = {fault["loc"][:length] for fault in error.errors() for length in (1, 2)}
    sound = {key: value for key, value in raw.items() if key in Study.model_fields and (key,) not in wrong}
    if isinstance(entries := raw.get("estimators"), list) and entries:
        sound["estimators"] = [
            SOUND["estimators"][0] if ("estimators", place) in wrong else entry
            for place, entry in enumerate(entries)
        ]
    return Study.model_validate(SOUND | sound)
