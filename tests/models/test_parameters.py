"""What parameters of a family may be."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import pytest

import neurosym_jax as nj
from neurosym_jax.errors import InputError
from neurosym_jax.models import Lengths


@dataclasses.dataclass(frozen=True)
class Tuples(nj.Forecaster):
    """Its parameters are no dictionary, as those of an Equinox module."""

    Config: ClassVar = Lengths
    title: ClassVar[str] = "tuples"

    def init(self, key):
        """Parameters that a folder cannot hold."""
        return (jax.random.normal(key, (3,)),)

    def forecast(self, params, scene, noise):
        """People stand."""
        return jnp.zeros((1, *scene.observed.shape))


def test_parameters_that_would_not_come_back_are_refused_before_training():
    with pytest.raises(InputError, match="must be nested dictionaries of arrays"):
        Tuples(Lengths()).shapes()
