"""Memory of this machine and of its processes, and what a plug-in may take of it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

MAX_MEMORY_GB = 8.0  # of a plug-in, unless more is allowed


def machine_memory_gb() -> float:
    """Memory of this machine, GB; twice MAX_MEMORY_GB where the system does not tell."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (AttributeError, ValueError, OSError):
        return 2 * MAX_MEMORY_GB


def default_memory_gb() -> float:
    """Half of the machine's memory, at most MAX_MEMORY_GB."""
    return min(MAX_MEMORY_GB, machine_memory_gb() / 2)


def limit_in_words(memory_gb: float) -> str:
    """A limit of memory, and the key that changes it."""
    return f"{memory_gb:.3g} GB of memory (plugin_memory_gb)"


def resident_gb(process: int) -> float:
    """Resident memory of a process, GB; 0 where the system does not tell."""
    with suppress(OSError, ValueError, IndexError):
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e9
    return 0.0
