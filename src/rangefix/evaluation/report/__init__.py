"""One self-contained page about a folder of results."""

from .report import write_report

__all__ = ["write_report"]
