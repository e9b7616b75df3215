"""Names that a package offers and loads when they are first asked for: who needs one waits for no other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, which takes time to load
if TYPE_CHECKING:
    from typing import Any

__all__ = ["offered_by"]


def offered_by(
    package: str, modules: Mapping[str, tuple[str, ...]], aliases: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package.

    Args:
        package: Its name.
        modules: Module within it -> names that it offers there; the first folder of each is offered, too.
        aliases: Other names that it has -> the names that they stand for.
    """
    where = {name: module for module, names in modules.items() for name in names}
    folders = {module.split(".")[0] for module in modules}
    others = dict(aliases or {})

    def load(name: str) -> Any:
        """Load a name, or a folder."""
        wanted = others.get(name, name)
        if wanted in where:
            value = getattr(import_module(f".{where[wanted]}", package), wanted)
        elif name in folders:
            return import_module(f".{name}", package)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        vars(import_module(package))[name] = value
        return value

    def offered() -> list[str]:
        """What tab completion shows."""
        return sorted({*where, *others, *folders, *vars(import_module(package))})

    return load, offered
