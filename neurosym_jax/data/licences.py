"""Licences of the data sets that models learn from."""

from collections.abc import Iterable

__all__ = ["LICENCES", "UNSTATED", "licences_of"]

UNSTATED = "unstated"
"""The publisher states no licence, or it is not known here."""

LICENCES = {
    "ETH/UCY": UNSTATED,
    "SDD": "CC BY-NC-SA 3.0",
    "simulations": "MIT",
}
"""By name; look a licence up at its source before a model that learned from the data ships."""


def licences_of(names: Iterable[str]) -> dict[str, str]:
    """The licence of each data set, by its name in `LICENCES` whatever its case."""
    known = {name.casefold(): name for name in LICENCES}
    found = (known.get(name.casefold(), name) for name in names)
    return {name: LICENCES.get(name, UNSTATED) for name in found}
