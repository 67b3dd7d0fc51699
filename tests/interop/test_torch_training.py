"""A training in torch is continued: its next step of Adam is ours."""

import jax
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.errors import InputError
from neurosym_jax.interop import load_torch_training
from neurosym_jax.models.sgan.torch_names import params_from_torch
from neurosym_jax.training.state import update
from tests.interop.test_modules import ARGUMENTS, SGAN, network_of

OWN = {
    **ARGUMENTS, "d_type": "local", "best_k": 7, "batch_size": 5,
    "g_learning_rate": 3e-3, "d_learning_rate": 2e-3, "clipping_threshold_g": 0.7,
    "l2_loss_weight": 0.5, "d_steps": 2, "g_steps": 1,
}  # fmt: skip


def steps_of(torch, network, rate, count, seed=0):
    """Adam after `count` steps along random gradients, and the last gradients by name."""
    adam, rng = (
        torch.optim.Adam(network.parameters(), lr=rate),
        np.random.default_rng(seed),
    )
    gradients = {}
    for _ in range(count):
        for name, parameter in network.named_parameters():
            gradients[name] = rng.normal(0, 0.01, parameter.shape).astype(np.float32)
            parameter.grad = torch.tensor(gradients[name])
        norm = OWN["clipping_threshold_g"]
        torch.nn.utils.clip_grad_norm_(network.parameters(), norm)
        adam.step()
    return adam, gradients


@pytest.fixture
def checkpoint(torch, tmp_path):
    network, code = network_of(torch, ARGUMENTS), {}
    exec(SGAN.read_text(), code)
    critic = torch.nn.Module()
    critic.encoder = code["Encoder"](6, 9)
    critic.real_classifier = code["make_mlp"]([9, 11, 1])
    adams = steps_of(torch, network, 3e-3, 3)[0], steps_of(torch, critic, 2e-3, 5)[0]
    contents = {
        "args": OWN, "g_state": network.state_dict(), "d_state": critic.state_dict(),
        "g_optim_state": adams[0].state_dict(), "d_optim_state": adams[1].state_dict(),
    }  # fmt: skip
    torch.save(contents, tmp_path / "training.pt")
    return network, contents, tmp_path / "training.pt"


@pytest.mark.slow
def test_the_next_step_is_torchs(torch, checkpoint):
    network, contents, path = checkpoint
    training = load_torch_training(path)
    recipe, state = training.recipe, training.state
    assert (recipe.best_k, recipe.batch_scenes, recipe.clip_norm) == (7, 5, 0.7)
    assert (recipe.variety_weight, recipe.discriminator_steps) == (0.5, 2)
    assert recipe.discriminator.kind == "local"
    assert (recipe.discriminator.h_dim, recipe.discriminator.mlp_dim) == (9, 11)
    counts = [leaf for leaf in jax.tree.leaves(state.extra.optimizer) if leaf.ndim == 0]
    assert [int(count) for count in counts] == [5]
    # Torch goes on, and so do we along the same gradients.
    adam = torch.optim.Adam(network.parameters(), lr=1.0)
    adam.load_state_dict(contents["g_optim_state"])
    rng = np.random.default_rng(9)
    gradients = {}
    for name, parameter in network.named_parameters():
        gradients[name] = rng.normal(0, 0.01, parameter.shape).astype(np.float32)
        parameter.grad = torch.tensor(gradients[name])
    torch.nn.utils.clip_grad_norm_(network.parameters(), 0.7)
    adam.step()
    ours = {"params": params_from_torch(gradients, training.config)}
    after = update(recipe, state, ours).params["params"]
    theirs = {name: value.numpy() for name, value in network.state_dict().items()}
    expected = params_from_torch(theirs, training.config)
    before = state.params["params"]
    moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), before, expected)
    assert min(jax.tree.leaves(moved)) > 1e-4
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=3e-7), after, expected
    )


def test_the_rate_and_the_order_are_the_optimisers_own(torch, checkpoint, tmp_path):
    """Torch goes on at the saved rate; torch 0.4 named parameters by their addresses."""
    _, contents, path = checkpoint
    expected = load_torch_training(path).state.optimizer
    saved = contents["g_optim_state"]
    (group,) = saved["param_groups"]
    address = {number: 140_000 - 64 * number for number in group["params"]}
    group |= {"lr": 7e-4, "params": list(address.values())}
    saved["state"] = {address[n]: entry for n, entry in saved["state"].items()}
    torch.save(contents, tmp_path / "old.pt")
    training = load_torch_training(tmp_path / "old.pt")
    assert training.recipe.learning_rate == 7e-4
    assert training.recipe.d_learning_rate == 2e-3
    jax.tree.map(np.testing.assert_array_equal, training.state.optimizer, expected)


@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("g_optim_state", {"betas": (0.5, 0.999)}, r"betas is \(0.5, 0.999\)"),
        ("d_optim_state", {"weight_decay": 0.1}, "weight_decay is 0.1"),
        ("args", {"clipping_threshold_d": 1.0}, "clipping_threshold_d is 1.0"),
        ("args", {"g_steps": 2}, "g_steps is 2"),
    ],
)
def test_a_training_that_ours_cannot_continue_is_refused(
    torch, checkpoint, tmp_path, part, change, message
):
    _, contents, _ = checkpoint
    options = contents[part]
    if part != "args":
        (options,) = options["param_groups"]
    # The fixture's arguments are shared.
    contents["args"] = dict(contents["args"])
    target = contents["args"] if part == "args" else options
    target.update(change)
    torch.save(contents, tmp_path / "other.pt")
    with pytest.raises(InputError, match=message):
        load_torch_training(tmp_path / "other.pt")


def test_a_file_without_a_training_is_refused(torch, checkpoint, tmp_path):
    _, contents, _ = checkpoint
    del contents["d_optim_state"]
    torch.save(contents, tmp_path / "less.pt")
    with pytest.raises(InputError, match=r"less.pt: has no d_optim_state"):
        load_torch_training(tmp_path / "less.pt")
    assert nj.models.learn
