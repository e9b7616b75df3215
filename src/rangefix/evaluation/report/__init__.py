"""One self-contained page about a folder of results, or about several of one study."""

from .report import write_report
from .several import write_comparison

__all__ = ["write_comparison", "write_report"]
