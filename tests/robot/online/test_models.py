"""Models side by side are told apart by their kind, or else by their names."""

from pathlib import Path

import pytest

from neurosym_jax.errors import InputError
from neurosym_robot.online.models import load_models

SHIPPED = Path(__file__).resolve().parents[3] / "checkpoints"


def test_names_of_models_side_by_side():
    sgan, neurosym = SHIPPED / "sgan_zara1_8", SHIPPED / "neurosym_zara1_8"
    assert list(load_models((neurosym, sgan))) == ["NeuroSyM", "SGAN"]
    assert list(load_models((sgan,))) == ["SGAN"]
    both = load_models((sgan, SHIPPED / "sgan_eth_8"))
    assert list(both) == ["sgan_zara1_8", "sgan_eth_8"]
    with pytest.raises(InputError, match="at least one"):
        load_models(())
    with pytest.raises(InputError, match="differ in kind or name"):
        load_models((sgan, sgan))
