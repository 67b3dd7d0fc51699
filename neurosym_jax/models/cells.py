"""The table of recurrent cells."""

from neurosym_jax.models.cell import Cell
from neurosym_jax.models.lstm import LSTM
from neurosym_jax.registry import Registry

__all__ = ["CELLS", "register_cell"]

CELLS: Registry[type[Cell]] = Registry("cell", {"lstm": LSTM})

register_cell = CELLS.register
