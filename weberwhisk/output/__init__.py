"""What is written: files, and a command's folder of them, all of it or nothing."""

from .files import atomic_write, csv_text, locked, to_json
from .run import Run

__all__ = ["Run", "atomic_write", "csv_text", "locked", "to_json"]
