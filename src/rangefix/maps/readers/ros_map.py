"""Maps of ROS: the .yaml and the image that map_server and nav2 save (trinary, scale and raw)."""

from __future__ import annotations

import warnings
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from ...arrays import TWO_PI, Array, BoolArray
from ...errors import one_line
from ...text_files import read_text
from ..base import MapError
from ..occupancy import FREE, UNKNOWN, WALL, OccupancyMap, Unknown, WallLines

YAMLS = (".yaml", ".yml")
MOST_BYTES = 1 << 20  # of the .yaml
BYTES_A_PIXEL = 24  # that reading takes at its peak, measured
MODES = ("trinary", "scale", "raw")
KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")
ALIKE = 0.8  # of a key to one of these, from which on it is one that is misspelt
MOST_DEEP = 20  # lists and tables in one another


class MapYaml(NamedTuple):
    """What the .yaml of a map says.

    Attributes:
        image: The image's path, as written.
        resolution: Size of a pixel, m.
        origin: Where the lower left corner of the image lies, x1 and x2 (m), and its yaw (rad
            counter-clockwise).
        negate: Whether white is occupied instead of black.
        occupied_thresh: Pixels more probably occupied than that are walls.
        free_thresh: Pixels less probably occupied than that are free.
        mode: "trinary", "scale" or "raw".
    """

    image: str
    resolution: float
    origin: tuple[float, float, float]
    negate: bool = False
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196
    mode: str = "trinary"


def read_ros_map(
    path: Path,
    *,
    unknown: Unknown = "excluded",
    wall_lines: WallLines = "edges",
    reachable_from: ArrayLike | None = None,
    memory_gb: float = 2.0,
    image_anywhere: bool = False,
) -> OccupancyMap:
    """The occupancy map that a .yaml of map_server describes.

    x1 and x2 are the x and y of the map's frame. Pixels whose alpha is not full are unknown in every mode.

    Args:
        path: The .yaml.
        unknown, wall_lines: What unknown cells are, and where beams end; see `OccupancyMap`.
        reachable_from: A point of the free area that is meant, m.
        memory_gb: The most memory that the image may take while it is read.
        image_anywhere: Whether the image may lie outside the folder of the .yaml.

    Raises:
        MapError: If the .yaml or the image is broken, elsewhere or too large, or the map cannot be; one line
            that names the file.
    """
    if not (isinstance(memory_gb, int | float) and memory_gb > 0):
        raise MapError(f"{path}: memory_gb must be a positive number, got {memory_gb!r}")
    told = read_yaml(path)
    image = image_path(path, told.image, image_anywhere)
    shades, opaque = _grey_and_opaque(image, memory_gb)
    if opaque is not None and not opaque.any():
        raise MapError(
            f"{path}: no pixel of its image is opaque, and others are unknown: save it without transparency"
        )
    states = states_of(shades, opaque, told)
    along_axes = np.ascontiguousarray(states[::-1].T)  # rows run down from the top, x2 runs up
    return OccupancyMap(
        along_axes,
        told.resolution,
        told.origin[:2],
        told.origin[2],
        unknown=unknown,
        wall_lines=wall_lines,
        reachable_from=reachable_from,
        name=str(path),
    )


def read_yaml(path: Path) -> MapYaml:
    """What a .yaml of map_server says.

    Raises:
        MapError: If it is not such a file; tags, anchors and aliases are refused.
    """
    if path.stat().st_size > MOST_BYTES:
        raise MapError(f"{path}: has more than {MOST_BYTES} bytes: no map_server file")
    try:
        content = _plain_yaml(read_text(path))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise MapError(f"{path}: not a map_server .yaml ({one_line(error)})") from None
    missing = [key for key in ("image", "resolution", "origin") if key not in content]
    if missing:
        raise MapError(f"{path}: a map_server .yaml needs {', '.join(missing)}")
    origin = content["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise MapError(f"{path}: origin is [x, y, yaw] in m and rad, got {origin!r}")
    if not isinstance(content["image"], str) or not content["image"].strip():
        raise MapError(f"{path}: image is the name of a file, got {content['image']!r}")
    for key in content:
        if key not in KEYS and (meant := get_close_matches(str(key).lower(), KEYS, n=1, cutoff=ALIKE)):
            raise MapError(f"{path}: unknown key {key!r:.60}; did you mean {meant[0]}?")
    negate = _number(path, "negate", _as_number(content.get("negate", 0)))
    if negate not in (0, 1):
        raise MapError(f"{path}: negate is 0 or 1, got {negate:g}")
    mode = content.get("mode", "trinary")
    if mode not in MODES:
        raise MapError(f"{path}: mode is {', '.join(MODES)}, not {mode!r}")
    told = MapYaml(
        image=content["image"],
        resolution=_number(path, "resolution", content["resolution"], above=0.0),
        origin=(
            _number(path, "origin x", origin[0]),
            _number(path, "origin y", origin[1]),
            _number(path, "origin yaw", origin[2]),
        ),
        negate=bool(negate),
        mode=mode,
        occupied_thresh=_number(path, "occupied_thresh", content.get("occupied_thresh", 0.65)),
        free_thresh=_number(path, "free_thresh", content.get("free_thresh", 0.196)),
    )
    if not 0 <= told.free_thresh <= told.occupied_thresh <= 1:
        between = f"got {told.free_thresh:g} and {told.occupied_thresh:g}"
        raise MapError(f"{path}: 0 <= free_thresh <= occupied_thresh <= 1 must hold, {between}")
    if abs(told.origin[2]) > TWO_PI * (1 + 1e-6):
        raise MapError(f"{path}: the yaw of its origin is in rad, up to a full turn, got {told.origin[2]:g}")
    return told


def _plain_yaml(text: str) -> dict[str, Any]:
    """A table of YAML without tags, anchors or keys that stand twice."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if getattr(event, "anchor", None) is not None:  # an alias has one, too
            raise ValueError("anchors and aliases are not read")
        if (tag := getattr(event, "tag", None)) is not None:
            raise ValueError(f"tags are not read: {tag}")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MOST_DEEP:
            raise ValueError(f"tables lie more than {MOST_DEEP} deep in one another")
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    if not isinstance(root, yaml.MappingNode):
        raise ValueError("it is no table of keys and values")
    keys = [str(key.value) for key, _ in root.value]
    if twice := sorted({key for key in keys if keys.count(key) > 1}):
        raise ValueError(f"{', '.join(twice)} stands twice")
    content: dict[str, Any] = yaml.safe_load(text)
    return content


def _as_number(value: Any) -> Any:
    """True and false as one and zero, which they stand for where something is or is not."""
    return int(value) if isinstance(value, bool) else value


def _number(path: Path, key: str, value: Any, above: float = -np.inf) -> float:
    """A finite number of the .yaml."""
    if isinstance(value, str):  # YAML 1.1 takes 1e-3 for a text
        with suppress(ValueError):
            value = float(value)
    with suppress(OverflowError):  # of a whole number of more than 308 digits
        if (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and np.isfinite(float(value))
            and value > above
        ):
            return float(value)
    raise MapError(
        f"{path}: {key} must be a finite number{' above 0' if above == 0 else ''}, got {value!r:.60}"
    )


def image_path(path: Path, image: str, anywhere: bool) -> Path:
    """The image that a .yaml names: beside it or in a folder below, or anywhere if that is allowed.

    Raises:
        MapError: If it lies elsewhere, or there is none.
    """
    found = path.parent / image
    try:
        inside, there = found.resolve().is_relative_to(path.parent.resolve()), found.is_file()
    except (OSError, ValueError):  # of a name that is too long, or that no file can have
        raise MapError(f"{path}: its image cannot be called {image[:60]!r}") from None
    if not (anywhere or inside):
        raise MapError(
            f"{path}: its image {image!r} lies outside the folder of the .yaml; put it there and write its "
            "name alone, or allow it by image_anywhere"
        )
    if not there:
        raise MapError(f"{path}: there is no image {image!r}")
    return found


def _grey_and_opaque(path: Path, memory_gb: float) -> tuple[Array, BoolArray | None]:
    """Shades from 0 (black) to 255 (white), rows from the top, and where alpha is full, if there is any.

    Raises:
        MapError: If it is too large for the memory, broken, or no image.
    """
    from PIL import Image, ImageFile, UnidentifiedImageError

    most, whole = Image.MAX_IMAGE_PIXELS, ImageFile.LOAD_TRUNCATED_IMAGES
    try:
        Image.MAX_IMAGE_PIXELS, ImageFile.LOAD_TRUNCATED_IMAGES = None, False  # what is too large we say
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                width, height = image.size
                need = BYTES_A_PIXEL * width * height / 1e9
                if need > memory_gb:
                    size = f"{width} x {height} pixels take {need:.1f} GB"
                    raise MapError(f"{path}: {size}, more than memory_gb = {memory_gb:g}")
                return _shades(image)
    except UnidentifiedImageError:
        raise MapError(f"{path}: no image that Pillow reads") from None
    except MapError:
        raise
    except (OSError, ValueError, SyntaxError, IndexError, MemoryError, EOFError, TypeError) as error:
        raise MapError(f"{path}: the image is broken ({one_line(error)})") from None
    finally:
        Image.MAX_IMAGE_PIXELS, ImageFile.LOAD_TRUNCATED_IMAGES = most, whole


def _shades(image: Any) -> tuple[Array, BoolArray | None]:
    """The shades of an opened image, and where its alpha is full."""
    if image.mode == "I" or image.mode.startswith("I;16"):
        return np.asarray(image, dtype=np.float64) / 257, None  # of 65535
    transparent = "A" in image.getbands() or "transparency" in image.info
    pixels = np.asarray(image.convert("RGBA" if transparent else "L" if image.mode in "1L" else "RGB"))
    if pixels.ndim == 2:
        return pixels.astype(np.float64), None
    shades = pixels[..., :3].sum(axis=-1, dtype=np.uint16) / 3
    return shades, pixels[..., 3] == 255 if transparent else None


def states_of(shades: Array, opaque: BoolArray | None, told: MapYaml) -> NDArray[np.uint8]:
    """What pixels are, by the rules of map_server: free, wall or unknown, in the shape of the image.

    Args:
        shades: From 0 (black) to 255 (white).
        opaque: Where alpha is full; None = everywhere.
        told: The .yaml. "trinary" and "scale" have the same walls and free cells: what is between the
            thresholds is neither, and so unknown. "raw" pixels are percentages from 0 to 100, compared with
            the thresholds, and unknown above.
    """
    if told.mode == "raw":
        values = np.round(shades)
        values = 255 - values if told.negate else values
        occupied, known = values / 100, values <= 100
    else:
        occupied = (shades if told.negate else 255 - shades) / 255
        known = np.ones(shades.shape, dtype=np.bool_)
    states = np.full(shades.shape, UNKNOWN, dtype=np.uint8)
    states[known & (occupied > told.occupied_thresh)] = WALL
    states[known & (occupied < told.free_thresh)] = FREE
    if opaque is not None:
        states[~opaque] = UNKNOWN
    return states
