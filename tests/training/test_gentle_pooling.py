"""Gentle training of poolings: each part has its effect, and no forecast changes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.training.gentle_pooling import slowed, started, with_leak
from neurosym_jax.training.gradients import warn_if_no_gradient


def generator(layers=2):
    mlp = {f"layer_{i}": {"kernel": jnp.ones((3, 2)), "bias": jnp.zeros(2)} for i in range(layers)}
    decoder = {"pooling": {"mlp": mlp}, "mlp": {"kernel": jnp.ones(4)}}
    return {"params": {"pooling": {"mlp": mlp}, "decoder": decoder}}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("gentle", [True, False])
def test_only_gradients_that_raise_a_dead_unit_leak(run, gentle, sign):
    module = run.network.pooling.network(8, obs_len=4, embedding_dim=4)
    rng = np.random.default_rng(0)
    hidden, position = (rng.normal(size=shape).astype(np.float32) for shape in ((4, 8), (4, 2)))
    inputs = hidden, position, np.ones(4, bool)
    params = module.init(jax.random.key(0), *inputs)["params"]
    layer = params["mlp"]["layer_1"]
    layer["bias"] = layer["bias"].at[0].set(-1e3)

    def pooled(params):
        variables = {"params": {"pooling": params}}
        training = with_leak(variables)["training"]["pooling"] if gentle else {}
        return module.apply({"params": params, "training": training}, *inputs)

    assert (pooled(params) == module.apply({"params": params}, *inputs)).all()
    gradient = jax.grad(lambda params: sign * pooled(params).sum())(params)
    leaked, alive = gradient["mlp"]["layer_1"]["bias"][:2]
    assert leaked == pytest.approx(-0.4 if gentle and sign < 0 else 0)
    assert alive == pytest.approx(4 * sign)


def test_poolings_with_a_bottleneck_start_small_and_learn_slowly():
    for part in (started(generator())["params"], started(generator())["params"]["decoder"]):
        layer = part["pooling"]["mlp"]["layer_1"]
        assert layer["bias"].tolist() == [0.5, 0.5]
        assert float(layer["kernel"].max()) == pytest.approx(0.3)
    slow = slowed(generator())["params"]
    assert float(slow["pooling"]["mlp"]["layer_0"]["kernel"].max()) == pytest.approx(0.05)
    assert (slow["decoder"]["mlp"]["kernel"] == 1).all()
    social = generator(layers=1)
    jax.tree.map(np.testing.assert_array_equal, started(slowed(social)), social)


def test_a_gradient_that_is_zero_everywhere_is_said(capsys):
    warn_if_no_gradient({"table": np.zeros(3), "scale": np.ones(1)}, "the weights")
    assert capsys.readouterr().err == ""
    warn_if_no_gradient({"table": np.zeros(3)}, "the weights")
    assert "the gradient by the weights is 0 in every entry" in capsys.readouterr().err
