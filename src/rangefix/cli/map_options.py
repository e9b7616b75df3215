"""The options that a map's file may need, the same for every command that opens one."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from functools import wraps
from typing import Annotated, Any, get_type_hints

import typer

from ..errors import printable
from .app import warn

Unit = Annotated[
    str | None, typer.Option("--unit", metavar="UNIT", help="Of a file's numbers: m, cm, mm, inch, foot.")
]
Up = Annotated[
    str | None, typer.Option("--up", metavar="AXIS", help="The axis of a mesh that points up: x, y or z.")
]


@dataclass(frozen=True)
class MapOptions:
    """What a map's file does not say, by the names of `open_map`; None = as it says, or as is usual."""

    sensor_height: Annotated[
        float | None,
        typer.Option("--sensor-height", metavar="METRES", help="Height z of the beams, m: for a mesh."),
    ] = None
    unit: Unit = None
    up: Up = None
    reachable_from: Annotated[
        tuple[float, float] | None,
        typer.Option("--reachable-from", metavar="X1 X2", help="A point of the free space that is meant, m."),
    ] = None
    floor_height: Annotated[
        float | None, typer.Option("--floor-height", metavar="METRES", help="z of a mesh's floor, m.")
    ] = None
    outline: Annotated[
        str | None, typer.Option("--outline", metavar="MAP", help="A mesh is free where this map is.")
    ] = None
    unknown: Annotated[
        str | None,
        typer.Option("--unknown", metavar="WHAT", help="Unknown cells are excluded, free or wall."),
    ] = None
    wall_lines: Annotated[
        str | None,
        typer.Option(
            "--wall-lines", metavar="WHAT", help="Beams end at edges of cells, or at the centre of walls."
        ),
    ] = None
    layers: Annotated[
        list[str] | None,
        typer.Option("--layer", metavar="NAME", help="Of a DXF; may be repeated, all else."),
    ] = None
    image_anywhere: Annotated[
        bool, typer.Option("--image-anywhere", help="The image of a .yaml may lie in another folder.")
    ] = False
    memory_gb: Annotated[
        float | None,
        typer.Option("--memory-gb", metavar="GB", help="Memory that an image may take, 2 unless given."),
    ] = None

    def opened(self, map_name: str) -> Any:
        """The map of a name.

        Raises:
            ValueError: If an option has no effect on such a map, or one is missing.
        """
        from ..maps import MapError, open_map
        from ..maps.readers.open_map import UnknownOptions

        options = {
            name: value for name, value in vars(self).items() if value is not None and value is not False
        }
        if not map_name.strip():
            raise ValueError("the name of the map is empty: name a file, or a room such as room:4x6")
        if self.memory_gb is not None and not self.memory_gb > 0:
            raise ValueError(f"--memory-gb must be positive, got {self.memory_gb:g}")
        with_height = needs_height(map_name)
        if with_height and "sensor_height" not in options:
            raise ValueError(f"{map_name}: a mesh needs --sensor-height, the height z of the beams in m")
        if with_height is False:
            if "sensor_height" in options:
                raise ValueError(f"--sensor-height has no effect on {map_name}: it is for a mesh")
            if map_name.startswith("room:") and options:
                have = "have" if len(options) > 1 else "has"
                raise ValueError(f"{_typed(options)} {have} no effect on {map_name}")
        try:
            if "outline" in options:
                options["outline"] = open_map(options["outline"])
            return open_map(map_name, **options)
        except UnknownOptions as error:
            have = "have" if len(error.unknown) > 1 else "has"
            takes = f"a {error.path.suffix.lower()} map takes {_typed(error.known)}"
            path = printable(str(error.path))
            raise ValueError(f"{path}: {_typed(error.unknown)} {have} no effect; {takes}") from None
        except MapError as error:
            raise ValueError(as_options(str(error))) from None

    def opened_and_told(self, map_name: str) -> Any:
        """The map of a name; what is odd about its file is told on standard error.

        Raises:
            ValueError: As `opened`.
        """
        room = self.opened(map_name)
        tell_odd(room, map_name)
        return room


def as_options(text: str) -> str:
    """What is wrong with a map, with options as they are typed, and not as Python or a study calls them."""
    from ..maps.readers.open_map import with_options_called

    typed = _options_typed()
    text = with_options_called(text, typed)
    text = re.sub(r"\b(unit|up) = '(\w+)'", r"--\1 \2", text)
    return re.sub(rf"({'|'.join(typed.values())}) = ", r"\1 ", text)


def _options_typed() -> dict[str, str]:
    """How each option is typed, by its name."""
    typed = {each.name: f"--{each.name.replace('_', '-')}" for each in fields(MapOptions)}
    return typed | {"layers": "--layer"}


def _typed(names: Iterable[str]) -> str:
    """Options as they are typed; those that no command has are left out."""
    typed = _options_typed()
    return ", ".join(typed[name] for name in names if name in typed)


def odd_about(room: Any) -> tuple[str, ...]:
    """What of a file is left out or coarse, and a size that tells of another unit, a sentence each."""
    from ..maps import FloorPlan, MeshRoom
    from ..maps.describe import odd_size

    return (*(room.remarks if isinstance(room, FloorPlan | MeshRoom) else ()), *odd_size(room))


def tell_odd(room: Any, name: str = "map") -> None:
    """The same on standard error."""
    for remark in odd_about(room):
        warn(f"{name}: {remark}")


AS_FILES_SAY = MapOptions()


def needs_height(map_name: str) -> bool | None:
    """Whether the height of the beams must be given; None for files of others, or that are not there."""
    from ..maps.readers.open_map import HEIGHT, READERS, kind_of

    if map_name.startswith("room:"):
        return False
    if not os.path.isfile(map_name):
        return None
    reader = READERS.get(kind_of(map_name))
    return None if reader is None else reader.needs == HEIGHT


def takes_map_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameter `map_options: MapOptions` stands for the options themselves."""
    names = [each.name for each in fields(MapOptions)]
    hints = get_type_hints(MapOptions, include_extras=True)

    @wraps(command)
    def with_options(**given: Any) -> None:
        command(map_options=MapOptions(**{name: given.pop(name) for name in names}), **given)

    parameters = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        if parameter.name == "map_options":
            parameters += [
                inspect.Parameter(
                    each.name,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=each.default,
                    annotation=hints[each.name],
                )
                for each in fields(MapOptions)
            ]
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
    with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return with_options
