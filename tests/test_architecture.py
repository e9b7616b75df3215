"""Imports go one way: maps and filters stand alone, evaluation uses both, the command line stands on top."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import rangefix
import rangefix.evaluation
import rangefix.filters

ROOT = Path(rangefix.__file__).parent
ON_TOP = {"cli", "__main__"}
GROUND = {
    "arrays",
    "compiled",
    "errors",
    "extensions",
    "file_lock",
    "lazy_names",
    "loop_cache",
    "quick_compiling",
    "raster",
    "text_files",
    "thread_pools",
}
MAY_IMPORT = {
    "maps": {"maps"} | GROUND,
    "filters": {"filters"} | GROUND,
    "evaluation": {"maps", "filters", "evaluation"} | GROUND,
}
DRAWING = ("rangefix.evaluation.figures", "rangefix.evaluation.paper.")
HEAVY = ("numpy", "scipy", "open3d", "filterpy", "matplotlib", "numba", "pydantic", "joblib", "rich")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("rangefix", *(part for part in parts if part != "__init__")))


MODULES = {module_name(path): path for path in sorted(ROOT.rglob("*.py"))}


@cache
def imports(name: str) -> list[tuple[int, str]]:
    """Level (0 = absolute) and full name of everything that a module imports."""
    path = MODULES[name]
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(0, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parents, *([base] if base else [])])
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                found.append((node.level, inner if inner in MODULES else base))
    return found


def room(name: str) -> str:
    """The room a module stands in: "rangefix.maps.mesh" -> "maps"; "" for the package itself."""
    return [*name.split("."), ""][1]


@pytest.mark.parametrize("name", MODULES)
def test_imports_inside_the_package_are_relative(name: str) -> None:
    """A copy of the package under another name would still import itself."""
    absolute = [
        target for level, target in imports(name) if level == 0 and target.split(".")[0] == "rangefix"
    ]
    assert not absolute


@pytest.mark.parametrize("name", MODULES)
def test_imports_go_one_way(name: str) -> None:
    """Maps import maps, filters import filters, evaluation imports both; only modules on top import all."""
    targets = {room(target) for level, target in imports(name) if level}
    if room(name) in MAY_IMPORT:
        assert targets <= MAY_IMPORT[room(name)]
    else:
        assert room(name) in ON_TOP | GROUND | {""}, f"say in this test where {name} stands"


@pytest.mark.parametrize("name", MODULES)
def test_only_figures_import_matplotlib(name: str) -> None:
    """Drawing stays in one place, and never by way of pyplot's global state."""
    drawing = {
        target for _, target in imports(name) if target.split(".")[0] in ("matplotlib", "mpl_toolkits")
    }
    if not name.startswith(DRAWING):
        assert not drawing
    assert not any("pyplot" in target for target in drawing)


def test_no_circles() -> None:
    """Modules have an order in which each imports only those before it, in functions and for types too."""
    graph = {
        name: {target for level, target in imports(name) if level and target in MODULES} for name in MODULES
    }
    graph = {name: targets - {name} for name, targets in graph.items()}
    assert list(TopologicalSorter(graph).static_order())


LAYERS = """
__main__
cli
evaluation
evaluation.drawing
evaluation.monte_carlo evaluation.report evaluation.paper
evaluation.figures evaluation.trials
evaluation.planning evaluation.bounds evaluation.recordings
evaluation.comparison
evaluation.consistency
evaluation.results evaluation.study
evaluation.study.sections evaluation.isolation
evaluation.experiment
evaluation.seeds
filters filters.checks
filters.point_mass
filters.adaptive
filters.exact filters.particle filters.kalman filters.registry
filters.refined_cells
filters.prior_ends
filters.models filters.images
filters.estimator filters.sampling filters.plugin_line filters.option_units filters.unknown_name
filters.measurement filters.optional_methods filters.estimate
filters.problem
filters.space filters.mount
maps
maps.readers
maps.describe
maps.mesh
maps.floor_plan maps.rectangle maps.occupancy
maps.free_space maps.free_moments
maps.casting maps.centre_lines
maps.mesh_formats
maps.polygon
maps._open3d maps.grid_kernels maps.polygon_kernels
maps.base
raster extensions compiled text_files
arrays errors rangefix
"""
RANKS = {
    "rangefix" if each == "rangefix" else f"rangefix.{each}": rank
    for rank, row in enumerate(LAYERS.strip().splitlines())
    for each in row.split()
}


def layer(name: str) -> str:
    """The room of LAYERS that a module stands in."""
    rooms = [each for each in RANKS if name == each or name.startswith(f"{each}.")]
    return max(rooms, key=len)


@pytest.mark.parametrize("name", sorted(MODULES.keys() - {"rangefix"}))  # whose imports are for type checkers
def test_rooms_take_from_below(name: str) -> None:
    """A room imports only what stands in a lower row of LAYERS; imports inside functions count."""
    for level, target in imports(name):
        if level and layer(target) != layer(name):
            assert RANKS[layer(target)] > RANKS[layer(name)], f"{name} imports {target}"


def test_no_room_is_a_hall() -> None:
    """A folder has at most 15 modules."""
    folders = [path.parent for path in MODULES.values() if path.name != "__init__.py"]
    assert max(folders.count(folder) for folder in folders) <= 15


def test_a_wrong_import_would_be_seen() -> None:
    """Negative control: the reader of imports does see filters from evaluation, and matplotlib in figures."""
    assert "filters" in {
        room(target) for level, target in imports("rangefix.evaluation.paper.table1") if level
    }
    assert any(target.startswith("matplotlib") for _, target in imports("rangefix.evaluation.figures.style"))


def test_the_command_line_loads_nothing_heavy() -> None:
    """Importing rangefix.cli loads no array, mesh, plotting or table library."""
    code = f"import sys, rangefix.cli; print([name for name in {HEAVY!r} if name in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_results_are_shown_without_what_makes_them() -> None:
    """Importing evaluation and the tables of the terminal leaves scipy and numba for those who need them."""
    code = (
        "import sys, rangefix.evaluation, rangefix.evaluation.drawing\n"
        "import rangefix.cli.tables.study, rangefix.cli.tables.remarks, rangefix.cli.tables.comparisons\n"
        "print(sorted({'scipy.special', 'scipy.stats', 'numpy.f2py', 'numba'} & sys.modules.keys()))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_figures_are_drawn_without_studies_and_maps() -> None:
    """What draws figures loads neither studies, nor maps, nor pages; their names are there when asked for."""
    code = (
        "import sys, rangefix.evaluation.drawing\n"
        "heavy = 'monte_carlo', 'study', 'report', 'paper'\n"
        "print([name for name in heavy if f'rangefix.evaluation.{name}' in sys.modules])\n"
        "face = rangefix.evaluation\n"
        "print('rangefix.maps' in sys.modules, {*face.__all__} <= {*dir(face)})\n"
        "print(face.study.Study is face.Study)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["[]", "False", "True", "True"]


@pytest.mark.parametrize("room", [rangefix.filters, rangefix.evaluation])
def test_names_of_a_face_are_loaded_when_asked_for(room: ModuleType) -> None:
    """Each is the one of its module, shown by completion; an unknown one is an error, as in any module."""
    offered = [name for names in room._MODULES.values() for name in names]
    assert {*offered, *room._OLDER} <= {*room.__all__}
    assert {*room.__all__} <= {*dir(room)}
    for module, names in room._MODULES.items():
        for name in names:
            assert getattr(room, name) is getattr(import_module(f"{room.__name__}.{module}"), name)
    for name, newer in room._OLDER.items():
        assert getattr(room, name) is getattr(room, newer)
    assert all(getattr(room, name) is not None for name in room.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Loud'"):
        room.Loud  # noqa: B018


def test_a_process_for_code_of_others_loads_no_study_and_no_report() -> None:
    """It is started for each estimator of somebody else: what it loads, they wait for."""
    code = (
        "import sys, rangefix.evaluation.trials.guard\n"
        "heavy = 'pydantic', 'scipy', 'numba', 'rangefix.evaluation.study', 'rangefix.evaluation.report'\n"
        "print(sorted({*heavy} & sys.modules.keys()))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_help_loads_nothing_heavy() -> None:
    """`rangefix --help` loads rich, for its panels, and none of the others."""
    code = (
        "import sys, contextlib, io\nfrom rangefix.cli import main\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): main(['--help'])\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "['rich']"
