"""Where people go from a place: a summary of a memory, to look at."""

from typing import NamedTuple

import numpy as np

from neurosym_jax.models.place.memory import Memory

__all__ = ["Flows", "flows_of"]

CELL = 1.0
"""Side of a cell of the floor, metres."""
SECTORS = 8
"""Directions that are told apart."""
STAYS = 0.5
"""Way in metres up to which a person stays."""
PEOPLE = 3
"""People in a cell from which on it is told."""
LEAST = 0.15
"""Least share of a cell's people that is told."""


class Flows(NamedTuple):
    """Ways of people from cells of the floor, F of them; a cell may have several."""

    start: np.ndarray
    """[F, 2] metres, mean position in the cell."""
    way: np.ndarray
    """[F, 2] metres, mean way over the steps that are forecast; about 0 of people who stay."""
    share: np.ndarray
    """[F] share of the people in the cell who went so."""
    people: np.ndarray
    """[F] how many they were."""


def flows_of(memory: Memory, origin: np.ndarray | None, most: int = 500) -> Flows:
    """The flows of a memory around `origin [2]`, those of `most` people at the most."""
    person = np.asarray(memory.person)
    known = person >= 0
    person = person[known].astype(np.int64)
    start = np.asarray(memory.moment)[known, :2].astype(np.float64)
    way = np.asarray(memory.onward)[known, -1].astype(np.float64)
    _, cell = np.unique(_codes(start), return_inverse=True)

    # A person counts once for each cell and direction.
    kinds = SECTORS + 1
    flow_of_moment = cell * kinds + _sectors(way)
    flow_and_person = np.unique(flow_of_moment * 2**31 + person)
    flow, people = np.unique(flow_and_person // 2**31, return_counts=True)
    cell_of_flow = flow // kinds
    crowd = np.bincount(cell_of_flow, people)
    in_cell = crowd[cell_of_flow]
    share = people / np.maximum(in_cell, 1)

    row = np.searchsorted(flow, flow_of_moment)
    moments = np.bincount(row, minlength=len(flow))[:, None]
    start_sum = np.zeros((len(flow), 2))
    way_sum = np.zeros((len(flow), 2))
    np.add.at(start_sum, row, start)
    np.add.at(way_sum, row, way)
    if origin is not None:
        start_sum += origin * moments

    is_told = (in_cell >= PEOPLE) & (share >= LEAST)
    told = np.flatnonzero(is_told)
    order = np.argsort(-people[told], kind="stable")
    kept = told[order[:most]]
    return Flows(
        start=start_sum[kept] / moments[kept],
        way=way_sum[kept] / moments[kept],
        share=share[kept],
        people=people[kept],
    )


def _codes(position: np.ndarray) -> np.ndarray:
    """[R] int64, a number for the cell of each `position [R, 2]`."""
    cell = np.floor(position / CELL).astype(np.int64)
    return cell[:, 0] * 2**31 + cell[:, 1]


def _sectors(way: np.ndarray) -> np.ndarray:
    """[R] the direction of `way [R, 2]`, `SECTORS` for a person who stays."""
    angle = np.arctan2(way[:, 1], way[:, 0])
    turns = angle / (2 * np.pi)
    sector = np.rint(turns * SECTORS).astype(np.int64) % SECTORS
    length = np.linalg.norm(way, axis=1)
    return np.where(length > STAYS, sector, SECTORS)
