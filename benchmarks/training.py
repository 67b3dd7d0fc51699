"""A training iteration of each recipe, beside torch's; that of `sgan` beside the original's too.

An iteration of `sgan` is a discriminator and a generator step on the same 64 scenes of
zara1's training split (about 780 agents), best of 20, 8 + 8 steps, with the published
sizes. The opponents are `torch_peer` and, with `--reference`, the original code, whose
own step functions and networks are run on the CPU. The opponent of `anchors` is
`torch_anchors`, on the same batch. Without `--data` the scenes are simulated.
"""

import argparse
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.light import Work, decoding, encoding, limit, lstm, machine_rates
from benchmarks.timing import OURS, alternate, rows


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.data.recordings import open_source
    from neurosym_jax.data.windows import cut_windows
    from neurosym_jax.models.sgan.training import RECIPES
    from neurosym_jax.training.batches import SceneStream

    source, scene = open_source(options.data), "zara1" if options.data else "cross-path"
    windows = cut_windows(source.recordings(scene, "train"), 8, 8)
    batches = SceneStream(windows, RECIPES["sgan"].batch_scenes, seed=0).steps(0, 2)
    contestants: dict[str, Any] = {
        OURS: functools.partial(generator_steps, "sgan", batches)
    }
    arrays = [unpadded(batches, index) for index in (0, 1)]
    if options.torch:
        contestants["torch peer"] = functools.partial(peer, arrays)
    if options.reference:
        contestants["original"] = functools.partial(original, arrays, options.reference)
    timings = alternate(contestants, 3 * options.repeats, warm=2)
    scenes, agents = (len(arrays[0][name]) for name in ("sizes", "observed"))
    table = rows(f"{scenes} scenes, {agents} agents, best of 20", timings)
    work = _work(arrays[0], discriminator=True) + _work(arrays[1], discriminator=False)
    light = limit(work, machine_rates(), table[0]["median"])
    ours = SceneStream(
        windows, RECIPES["ours"].batch_scenes, 0, RECIPES["ours"].max_agents
    )
    step = functools.partial(generator_steps, "ours", ours.steps(0, 1))
    table += rows("recipe ours", alternate({OURS: step}, 3 * options.repeats, warm=2))
    steps = {OURS: functools.partial(anchor_step, windows)}
    if options.torch:
        steps["torch peer"] = functools.partial(torch_anchor_step, windows)
    table += rows("recipe anchors", alternate(steps, 9 * options.repeats, warm=3))
    return {"title": "a training iteration", "rows": table, "light": light}


def _work(array: dict[str, np.ndarray], *, discriminator: bool) -> Work:
    """Return the work of one network's step."""
    from neurosym_jax.models.sgan.network import DiscriminatorConfig, GeneratorConfig

    config, scores = GeneratorConfig(), DiscriminatorConfig()
    agents, sizes = len(array["observed"]), array["sizes"].astype(float)
    pairs = float((sizes**2).sum())
    inner, width = scores.pool_hidden_dim, scores.h_dim
    judged = lstm(agents, config.obs_len + config.pred_len, width)
    judged += Work(agents * 2 * (width + 2) * inner + pairs * 2 * inner * width, 0)
    judged += Work(agents * 2 * scores.mlp_dim * (width + 1), 0)
    context = encoding(config, agents, pairs)
    if discriminator:
        return context + decoding(config, agents, 1) + _with_gradient(judged) * 2
    # All 20 are decoded; the best and the one that is judged once more, with a
    # gradient.
    decoded = decoding(config, agents, 20) + _with_gradient(decoding(config, agents, 2))
    return _with_gradient(context) + decoded + _with_gradient(judged)


def _with_gradient(forward: Work) -> Work:
    """A product has two in its gradient; tanh and sigmoid need only what they gave."""
    return forward._replace(flops=3 * forward.flops)


def unpadded(batches, index: int) -> dict[str, np.ndarray]:
    """One batch agent by agent: positions, displacements, and the sizes of its scenes."""
    parts = {"observed": [], "moves": [], "future": [], "sizes": []}
    for group in batches:
        valid = group.valid[index]
        parts["observed"].append(group.observed[index][valid])
        parts["moves"].append(group.displacement[index][valid])
        parts["future"].append(group.future[index][valid])
        parts["sizes"].append(valid.sum(axis=1))
    arrays = {name: np.concatenate(values) for name, values in parts.items()}
    start = arrays["observed"][:, -1:]
    arrays["future_moves"] = np.diff(
        np.concatenate([start, arrays["future"]], axis=1), axis=1
    )
    return arrays


def generator_steps(name: str, batches) -> Callable[[], None]:
    """One iteration of a generator's recipe, on batches that lie on the device."""
    import jax

    from neurosym_jax.models.forecaster import forecaster_of
    from neurosym_jax.models.sgan.network import GeneratorConfig
    from neurosym_jax.models.sgan.training import RECIPES, init_state, train_step

    generator, recipe, key = GeneratorConfig(), RECIPES[name], jax.random.key(0)
    forecaster = forecaster_of(generator)
    batches = jax.device_put(batches)
    state = jax.jit(lambda: init_state(generator, recipe, key))()

    def step(state):
        key_of_step = jax.random.fold_in(key, state.step)
        return train_step(forecaster, recipe, state, batches, key_of_step)

    return _iterate(jax.jit(step, donate_argnums=0), state)


def anchor_step(windows: Any) -> Callable[[], None]:
    """One iteration of recipe `anchors`."""
    import jax

    from neurosym_jax.training.state import gradient_step, new_state

    forecaster, recipe, params, batch = _anchors(windows)
    key, batch, state = (
        jax.random.key(0),
        jax.device_put(batch),
        new_state(recipe, params),
    )
    return _iterate(
        lambda state: gradient_step(forecaster, recipe, key, state, batch), state
    )


def torch_anchor_step(windows: Any) -> Callable[[], None]:
    """The same iteration of torch's, on the same batch."""
    from benchmarks.torch_anchors import TorchAnchors
    from benchmarks.torch_peer import finish, use_accelerator

    forecaster, recipe, params, batch = _anchors(windows)
    use_accelerator()
    peer = TorchAnchors(forecaster.config, recipe, params, batch)

    def iterate() -> None:
        peer.step()
        finish()

    return iterate


def _anchors(windows: Any) -> tuple[Any, Any, Any, Any]:
    """Forecaster, recipe, parameters and a batch."""
    import jax

    from neurosym_jax.models.anchors.forecaster import AnchorsForecaster
    from neurosym_jax.models.anchors.network import AnchorConfig
    from neurosym_jax.models.anchors.training import AnchorRecipe, AnchorStream

    forecaster, recipe = AnchorsForecaster(AnchorConfig()), AnchorRecipe()
    batch = AnchorStream(windows, recipe).batch(0)
    return forecaster, recipe, forecaster.init(jax.random.key(0)), batch


def _iterate(step: Callable[[Any], tuple[Any, Any]], state: Any) -> Callable[[], None]:
    import jax

    def iterate() -> None:
        nonlocal state
        state, _ = step(state)
        jax.block_until_ready(state)

    return iterate


def peer(arrays) -> Callable[[], None]:
    """Our own torch, see `torch_peer`; its two steps take the two batches."""
    from benchmarks.torch_peer import TorchPeer, finish, use_accelerator

    use_accelerator()
    wanted = ("observed", "moves", "future_moves", "sizes")
    peers = []
    for array in arrays:
        inputs = [array[name] for name in wanted]
        peers.append(TorchPeer(*inputs, best_k=20, clip=2.0))
    first, second = peers

    def iterate() -> None:
        first.discriminator_step()
        second.generator_step()
        finish()

    return iterate


def original(arrays, reference: Path) -> Callable[[], None]:
    """The original's own step functions, networks and losses, kept on the CPU."""
    import torch

    from benchmarks.original import load_script

    train = load_script(reference, "train")
    args = argparse.Namespace(
        obs_len=8,
        best_k=20,
        l2_loss_weight=1.0,
        clipping_threshold_g=2.0,
        clipping_threshold_d=0.0,
    )
    sizes = {"embedding_dim": 16, "mlp_dim": 64, "batch_norm": False}
    generator = train.TrajectoryGenerator(
        obs_len=8,
        pred_len=8,
        encoder_h_dim=32,
        decoder_h_dim=32,
        noise_dim=(8,),
        noise_mix_type="global",
        pooling_type="pool_net",
        pool_every_timestep=False,
        bottleneck_dim=8,
        **sizes,
    )
    discriminator = train.TrajectoryDiscriminator(
        obs_len=8, pred_len=8, h_dim=48, d_type="global", **sizes
    )
    for network in (generator, discriminator):
        network.apply(train.init_weights).train()
    g_optimizer = torch.optim.Adam(generator.parameters(), lr=1e-4)
    d_optimizer = torch.optim.Adam(discriminator.parameters(), lr=1e-3)
    first, second = (_collated(array) for array in arrays)

    def iterate() -> None:
        train.discriminator_step(
            args, first, generator, discriminator, train.gan_d_loss, d_optimizer
        )
        train.generator_step(
            args, second, generator, discriminator, train.gan_g_loss, g_optimizer
        )

    return iterate


def _collated(array: dict[str, np.ndarray]):
    """A batch as the original's loader hands it over: time first, scenes as (start, end)."""
    import torch

    agents, steps = len(array["observed"]), 16
    ends = np.cumsum(array["sizes"])
    names = ("observed", "future", "moves", "future_moves")
    tracks = [
        torch.as_tensor(array[name]).transpose(0, 1).contiguous() for name in names
    ]
    bounds = torch.as_tensor(np.stack([ends - array["sizes"], ends], axis=1))
    return [*tracks, torch.zeros(agents), torch.ones(agents, steps), bounds]
