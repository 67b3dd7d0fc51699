"""Databases, columnar files and JSON: tables of a user's own that are no text of rows."""

from pathlib import Path

from neurosym_jax.data.objects import MAGIC, table_in_json, table_in_storage
from neurosym_jax.data.readers.columns import Columns
from neurosym_jax.data.reading import Head, ReadOptions, read_head
from neurosym_jax.data.tracks import Tracks

__all__ = ["Json", "Storage"]


class Storage(Columns):
    """SQLite, HDF5, Parquet or Arrow."""

    title = "table in a database or a columnar file"

    def knows(self, head: Head) -> bool:
        """By the first bytes."""
        return any(head.magic.startswith(start) for start in MAGIC)

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in its table of tracks."""
        return self.take(table_in_storage(path, read_head(path).magic), options, period)


class Json(Columns):
    """JSON: rows, or people with lists."""

    title = "rows in JSON"

    def knows(self, head: Head) -> bool:
        """By the first character, where no reader of another JSON knows it."""
        return head.lines[0][:1] in ("{", "[")

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in its rows."""
        return self.take(table_in_json(path), options, period)
