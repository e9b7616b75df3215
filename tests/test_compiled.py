"""Compiled loops: shared out among threads, kept in a cache where there can be one, and announced."""

from __future__ import annotations

import ast
import gc
import itertools
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numba
import numpy as np
import pytest
from numba.core import event, ir, types
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Flags, run_frontend
from numba.core.cpu_options import FastMathOptions
from numba.core.errors import TypingError
from numba.core.targetconfig import ConfigStack, TargetConfig
from numba.core.types.functions import BaseFunction
from numba.core.typing import signature

from rangefix import compiled, loop_cache, quick_compiling
from rangefix.arrays import Array
from rangefix.compiled import exp_below_zero, njit
from rangefix.maps import FloorPlan, polygon_kernels
from rangefix.maps.casting import segment_kernels
from rangefix.maps.polygon import locate

SOURCE, TESTS = Path(compiled.__file__).parent, Path(__file__).parent

known_options = pytest.mark.skipif(
    not quick_compiling.OPTIONS_ARE_KNOWN,
    reason="this numba compares its options itself",
)
known_calls = pytest.mark.skipif(
    not quick_compiling.CALLS_ARE_KNOWN, reason="this numba finds the types of calls otherwise, by itself"
)

known_names = pytest.mark.skipif(
    not (quick_compiling.NAMES_ARE_KNOWN and quick_compiling.USES_ARE_KNOWN),
    reason="this numba keeps the names in a loop otherwise",
)

PREDICTED = """
import numpy as np
from rangefix.filters.exact import any_noise
from rangefix.filters.point_mass import turning_kernels
from rangefix.filters.refined_cells.range_model import predict

out = np.empty((1, 1, 1))
predict(np.array([[2.0]]), np.array([[[-1.0, 0.0]]]), np.array([[[0.5, 0.1]]]), out)
print(*out.ravel())
"""

LOOPS = """
from rangefix.compiled import njit

@njit(cache=True)
def plus_one(number):
    return number + 1
"""

BOTH = """
import sys, time
from pathlib import Path
import numba
from numba.core import event, types
from numba.core.codegen import CPUCodeLibrary
from loops import plus_one

begun, ready = Path(sys.argv[1], "begun"), Path(sys.argv[1], "ready")
compiled = []

def wait_for(file):
    while not file.exists():
        time.sleep(0.01)

class Counted(event.Listener):
    def on_start(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)
        begun.touch()
        wait_for(ready)
        time.sleep(0.3)
    def on_end(self, event):
        pass

numba.njit(lambda: None)()  # the first of all takes seconds
event.register("numba:compile", Counted())
if sys.argv[2] == "second":
    wait_for(begun)
    ready.touch()
print(plus_one(1), compiled)
"""

COMPILED = """
import gc, re, sys
from numba.core.dispatcher import Dispatcher
from rangefix.cli import main

sys.argv = ["rangefix", "run", sys.argv[1], "--runs", "2", "--workers", "1", "--out", sys.argv[2]]
try:
    main()
except SystemExit:
    pass
for loop in (each for each in gc.get_objects() if isinstance(each, Dispatcher)):
    told = [" ".join(map(str, signature)) for signature in loop.signatures]
    kinds = {re.sub("readonly |, [ACF](?=[)])", "", each) for each in told}
    if loop.py_func.__module__.startswith("rangefix.") and len(kinds) < len(loop.signatures):
        print("TWICE", loop.py_func.__qualname__, *told, sep="\\n", file=sys.stderr)
"""


def halves(first: int, last: int, values: Array, out: Array) -> None:
    out[first:last] += 0.5 * values[first:last]


@pytest.mark.parametrize("count", [0, 1, 2, 7, 8, 9, 1000])
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_every_step_is_done_once(count: int, threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "_threads", lambda: threads)
    values, out = np.arange(float(count)), np.zeros(count)
    compiled.in_threads(halves, count, 1e9, values, out)
    np.testing.assert_array_equal(out, 0.5 * values)


def test_a_failure_in_a_thread_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "_threads", lambda: 2)

    def fails(first: int, last: int) -> None:
        raise ZeroDivisionError(first)

    with pytest.raises(ZeroDivisionError):
        compiled.in_threads(fails, 4, 1e9)


def test_no_folder_for_a_cache_is_no_mistake(tmp_path: Path) -> None:
    """Neither beside the source nor in the home can a folder be made."""
    nowhere = tmp_path / "file"
    nowhere.touch()
    block = (
        "import numba.core.caching as c; c.InTreeCacheLocator.from_function = classmethod(lambda *_: None)\n"
    )
    variables = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    bare = variables | {"HOME": str(nowhere), "XDG_CACHE_HOME": str(nowhere)}
    told = subprocess.run(
        [sys.executable, "-c", block + PREDICTED], env=bare, capture_output=True, text=True, check=True
    )
    assert (told.stdout, told.stderr) == ("1.5\n", "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such locks")
def test_processes_that_start_together_compile_a_loop_once(tmp_path: Path) -> None:
    """The second begins when the first compiles; its answer comes from the first one's cache."""
    (tmp_path / "loops.py").write_text(LOOPS)
    variables = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", BOTH, str(tmp_path)]
    both = [
        subprocess.Popen([*command, name], env=variables, stdout=subprocess.PIPE, text=True)
        for name in ("first", "second")
    ]
    told = [process.communicate()[0] for process in both]
    assert told == ["2 ['plus_one']\n", "2 []\n"]


@pytest.mark.parametrize("study", ["drive", "map_errors"])
def test_no_loop_is_compiled_twice_for_arrays_of_another_order_or_read_only(
    tmp_path: Path, study: str
) -> None:
    """In one study; each takes half a second the first time."""
    command = [sys.executable, "-c", COMPILED, study, str(tmp_path / "out")]
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "Results:" in told.stdout
    assert "TWICE" not in told.stderr, told.stderr


def test_garbage_is_looked_for_seldom_only_while_loops_are_compiled() -> None:
    """As often as before afterwards, also where one loop has another compiled, or cannot be compiled."""
    before, seen = gc.get_threshold(), []

    class Looks(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            seen.append(gc.get_threshold()[0])

        def on_end(self, event: object) -> None:
            seen.append(gc.get_threshold()[0])

    @njit()
    def inner(value: float) -> float:
        return value + 1.0

    @njit()
    def outer(value: float) -> float:
        return 2.0 * inner(value)

    @njit()
    def wrong(value: float) -> float:
        return value.nothing  # type: ignore[attr-defined, no-any-return]

    with event.install_listener("numba:compile", Looks()):  # type: ignore[no-untyped-call]
        assert outer(1.0) == 4.0
    assert gc.get_threshold() == before
    assert max(seen) == compiled.OBJECTS
    with pytest.raises(TypingError):
        wrong(1.0)
    assert gc.get_threshold() == before


@pytest.mark.parametrize(
    ("module", "asked", "level"),
    [
        ("rangefix.example", None, compiled.OPTIMISATION),
        ("rangefix.example", "3", None),
        ("someone.else", None, None),
    ],
)
def test_our_loops_alone_are_optimised_at_a_lower_level(
    monkeypatch: pytest.MonkeyPatch, module: str, asked: str | None, level: int | None
) -> None:
    """It is set while they are compiled, where nobody has asked for another, and is as it was afterwards."""
    monkeypatch.delenv("NUMBA_OPT", raising=False)
    if asked is not None:
        monkeypatch.setenv("NUMBA_OPT", asked)
    before, seen = numba.config.OPT, []

    class Looks(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            seen.append(int(numba.config.OPT))

        def on_end(self, event: object) -> None:
            pass

    def twice(value: float) -> float:
        return 2.0 * value

    twice.__module__ = module
    with event.install_listener("numba:compile", Looks()):  # type: ignore[no-untyped-call]
        assert njit()(twice)(1.0) == 2.0
    assert seen == [int(before) if level is None else level]
    assert before == numba.config.OPT


@known_options
def test_numbas_options_are_compared_as_by_numba_itself() -> None:
    """All pairs of options that are set to their defaults, to other values, and not at all."""
    ways: list[dict[str, object]] = [
        {}, {"error_model": "python"}, {"error_model": "numpy"},
        {"release_gil": True}, {"release_gil": False},
        {"error_model": "numpy", "release_gil": True, "fastmath": FastMathOptions({"contract"})},
        {"error_model": "numpy", "release_gil": True, "fastmath": FastMathOptions({"reassoc"})},
    ]  # fmt: skip
    every = [Flags() for _ in ways] + [Flags() for _ in ways] + [TargetConfig()]
    for options, way in zip(every, [*ways, *ways, {}], strict=True):
        for name, value in way.items():
            setattr(options, name, value)

    def compared() -> list[tuple[object, ...]]:
        pairs = itertools.product(every, every)
        return [(one == other, one != other, hash(one), one == 3) for one, other in pairs]

    before = compared()
    quick_compiling.compile_quickly(ours=False)
    try:
        assert TargetConfig.__eq__ is not quick_compiling.COMPARED[0]
        assert compared() == before
    finally:
        quick_compiling.as_numba_does()
    assert (TargetConfig.__eq__, TargetConfig.__hash__) == quick_compiling.COMPARED


@pytest.mark.parametrize("module", ["rangefix.of_ours", "of_others"])
def test_numba_is_spared_only_while_loops_are_compiled(module: str) -> None:
    """LLVM optimises the functions of others' loops by themselves too."""
    numbas = [
        (TargetConfig, "__eq__"),
        (BaseFunction, "get_call_type"),
        (ir.Scope, "__deepcopy__"),
        (ir.Loc, "__deepcopy__"),
        (ir.Inst, "_rec_list_vars"),
        (CPUCodeLibrary, "_optimize_functions"),
    ]
    seen = []

    def now() -> list[object]:
        return [getattr(kind, name, None) for kind, name in numbas]

    class Looks(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            seen.append([one is not other for one, other in zip(now(), before, strict=True)])

        def on_end(self, event: object) -> None:
            pass

    def thrice(value: float) -> float:
        return 3.0 * value

    thrice.__module__ = module
    before, ours = now(), module.startswith("rangefix.")
    known = [
        quick_compiling.OPTIONS_ARE_KNOWN,
        quick_compiling.CALLS_ARE_KNOWN,
        quick_compiling.NAMES_ARE_KNOWN,
        quick_compiling.NAMES_ARE_KNOWN,
        quick_compiling.USES_ARE_KNOWN,
        quick_compiling.PASSES_ARE_KNOWN and ours,
    ]
    with event.install_listener("numba:compile", Looks()):  # type: ignore[no-untyped-call]
        assert njit()(thrice)(1.0) == 3.0
    assert seen == [known]
    assert now() == before


@known_calls
def test_loops_that_call_the_same_divide_each_as_its_own_options_say() -> None:
    def share(one: float, two: float) -> float:
        return max(one, 0.0) / two

    for model in ("numpy", "python", "numpy"):
        loop = njit(error_model=model)(share)
        assert loop(1.0, 2.0) == 0.5
        if model == "python":
            with pytest.raises(ZeroDivisionError):
                loop(1.0, 0.0)
        else:
            assert loop(1.0, 0.0) == np.inf


@known_calls
def test_numba_asks_once_what_a_call_with_such_arguments_is() -> None:
    """And finds the loop that the same options led to, though others were asked for in between."""
    asked = []

    class Sums:
        """What numba keeps of a name: `get_call_type` writes down what does it."""

        def __init__(self) -> None:
            self._impl_keys: dict[object, object] = {}

    def ask(sums: Sums, context: object, arguments: Sequence[object], named: dict[str, object]) -> object:
        asked.append(options.top_or_none())
        found = signature(types.float64, *arguments)
        sums._impl_keys[found.args] = len(asked)
        return found

    options, sums = ConfigStack(), Sums()
    quick, usual = Flags(), Flags()
    quick.error_model = "numpy"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quick_compiling, "ASK", ask)
        patch.setattr(quick_compiling, "KNOWN_CALLS", {})
        for flags, expected in ((quick, 1), (usual, 2), (quick, 1), (usual, 2)):
            with options.enter(flags):
                found = quick_compiling._ask_once(sums, None, [types.float64, types.float64], {})
            assert found == signature(types.float64, types.float64, types.float64)
            assert sums._impl_keys[found.args] == expected
        with options.enter(quick):
            quick_compiling._ask_once(sums, None, [types.float64, types.int64], {})
            quick_compiling._ask_once(sums, None, [types.float64], {"start": types.int64})
    assert len(asked) == 4


@njit(error_model="numpy", inline="always")
def nearest(values: Array, wanted: float) -> int:
    """Called from two places below, which have names of their own for the same."""
    best, off = 0, np.inf
    for place in range(values.size):
        away = abs(values[place] - wanted)
        if away < off:
            best, off = place, away
    return best


def between_nearest(values: Array, wanted: float) -> float:
    best, off = nearest(values, wanted - 1.0), 0.5
    return float(off * (values[best] + values[nearest(values, wanted + 1.0)]))


@known_names
def test_loops_in_the_places_of_calls_are_compiled_to_what_numba_makes_of_them() -> None:
    """To the same code, but for the numbers by which numba tells what it has compiled."""
    made = []
    for quickly in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            if not quickly:
                patch.setattr(compiled, "compile_quickly", lambda ours: None)
            loop: Any = njit(error_model="numpy")(between_nearest)
            assert loop(np.array([0.0, 3.0, 5.0]), 4.0) == 4.0
        (code,) = loop.inspect_llvm().values()
        made.append(re.sub(r" *;.*|\d+", "", code).splitlines())
    assert len(made[0]) > 50
    assert made[0] == made[1]


@known_names
def test_names_that_instructions_hold_are_found_as_numba_finds_them() -> None:
    def varied(values: Array) -> tuple[object, ...]:
        values[0], values[1:] = values[1], 2.0
        pairs = [(value, -value) for value in values if value > 0.0]
        if not pairs:
            raise ValueError(f"none of {values}")
        return {"first": pairs[0]}, sum(one for one, _ in pairs), values.T[::-1], max(*pairs[0])

    blocks = run_frontend(varied).blocks.values()
    instructions = [each for block in blocks for each in block.body]
    expected = [each.list_vars() for each in instructions]
    assert sum(len(names) for names in expected) > 50
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ir.Inst, "_rec_list_vars", quick_compiling._names_of)
        assert [each.list_vars() for each in instructions] == expected


def test_loops_over_walls_are_compiled_once_for_arrays_of_any_order() -> None:
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 6.0], [0.0, 6.0]])
    points = np.array([[1.0, 1.0], [5.0, 5.0], [4.0, 3.0]])
    walls = FloorPlan(corners)._walls
    loops, counts = (polygon_kernels.locate_in_polygon, segment_kernels.see_past_segments), set()
    for given in (points, np.asfortranarray(points), np.repeat(points, 2, axis=0)[::2]):
        assert [*locate(given, corners)] == [1, -1, 0]
        assert [*locate(given[:1], corners)] == [1]
        assert [*walls.in_sight(given[:1], given[1:2])] == [False]
        counts.add(tuple(len(loop.signatures) for loop in loops))  # type: ignore[attr-defined]
    assert len(counts) == 1


def test_exp_below_zero_is_exact_to_two_units_in_the_last_place() -> None:
    """In a loop, which takes several at once; what is less than exp(-700) is that, and no denormal number."""

    @njit(error_model="numpy")
    def fill(powers: Array, weights: Array) -> None:
        for place in range(powers.size):
            weights[place] = exp_below_zero(powers[place])

    powers = np.concatenate([-np.geomspace(1e-18, 700.0, 2000), [0.0, -701.0, -1449.3, -1e300, -np.inf]])
    weights = np.empty_like(powers)
    fill(powers, weights)
    assert weights == pytest.approx(np.exp(np.maximum(powers, -700.0)), rel=4.5e-16, abs=0)


def decorated(node: ast.AST, by: str) -> TypeGuard[ast.FunctionDef]:
    """Whether it is a function with such a text among its decorators."""
    return isinstance(node, ast.FunctionDef) and any(by in ast.unparse(each) for each in node.decorator_list)


def outside_of_loops(tree: ast.AST) -> Iterator[str]:
    """Names that are used anywhere but in compiled loops."""
    for node in ast.iter_child_nodes(tree):
        if decorated(node, "njit("):
            continue
        if isinstance(node, ast.Name):
            yield node.id
        yield from outside_of_loops(node)


def inner_loops(tree: ast.AST) -> set[str]:
    return {node.name for node in ast.walk(tree) if decorated(node, "inner=True")}


def imported(tree: ast.AST) -> set[str]:
    return {name.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for name in node.names}


def test_python_calls_no_loop_that_only_loops_may_call() -> None:
    """Nothing would be told: the process would crash."""
    texts = {path: path.read_text() for folder in (SOURCE, TESTS) for path in folder.rglob("*.py")}
    inner = {path: inner_loops(ast.parse(text)) for path, text in texts.items() if "inner=True" in text}
    names = set().union(*inner.values())
    assert len(names) > 30
    for path, text in texts.items():
        if any(name in text for name in names):
            tree = ast.parse(text)
            there = inner.get(path, set()) | (names & imported(tree))
            assert not there & set(outside_of_loops(tree)), path


def test_inner_loops_are_compiled_without_what_lets_python_call_them() -> None:
    def plus_one(value: float) -> float:
        return value + 1.0

    inner = njit(inner=True)(plus_one)

    @njit()
    def outer(value: float) -> float:
        return 2.0 * inner(value)

    assert outer(1.0) == 4.0
    assert [*map(wrappers, (inner, outer))] == [(False, False), (True, False)]


def wrappers(loop: Any) -> tuple[bool, bool]:
    """Whether a loop was compiled with what lets Python, and C, call it."""
    (compiled_once,) = loop.overloads.values()
    names = compiled_once.fndesc
    code = compiled_once.library.get_llvm_str()
    return names.llvm_cpython_wrapper_name in code, names.llvm_cfunc_wrapper_name in code


READ = """
import sys
from numba.core.base import BaseContext

registered, register = [], BaseContext.refresh
def refresh(context):
    registered.append(context)
    register(context)
BaseContext.refresh = refresh

from rangefix.maps import FloorPlan
import numpy as np

plan = FloorPlan(outer=[[0, 0], [4, 0], [4, 3], [0, 3]])
ranges = plan.ranges(np.array([1.0, 1.0, 0.0]), np.zeros(1))
print(ranges.tolist(), len(registered), "scipy.linalg" in sys.modules)
"""


def test_loops_in_the_cache_are_read_without_numbas_registries() -> None:
    """They take a third of a second, and bring scipy.linalg."""
    command = [sys.executable, "-c", READ]
    subprocess.run(command, check=True, capture_output=True)  # fills the cache
    told = subprocess.run(command, check=True, capture_output=True, text=True)
    assert told.stdout == "[2.0] 0 False\n"


def test_a_cache_that_numba_keeps_otherwise_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_cache, "PARTS", ("unheard_of",))

    @njit(cache=True)
    def twice(number: float) -> float:
        return 2 * number

    assert twice(1.0) == 2.0
    assert "load_overload" not in vars(twice._cache)
