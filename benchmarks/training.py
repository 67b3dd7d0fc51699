"""A training iteration of recipe `sgan`, a discriminator and a generator step: ours and torch's.

All train on the same 64 scenes of zara1's training split (about 780 agents), best of 20,
8 + 8 steps, with the published sizes. The opponents are `torch_peer` and, with `--reference`, the
original code, whose own step functions and networks are run on the CPU.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.light import Work, decoding, encoding, limit, lstm, machine_rates
from benchmarks.timing import OURS, alternate, rows


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    batches = read_batches(options.need("data"))
    contestants = {OURS: ours(batches)}
    arrays = [unpadded(batches, index) for index in (0, 1)]
    if options.torch:
        contestants["torch peer"] = peer(arrays)
    if options.reference:
        contestants["original"] = original(arrays, options.reference)
    seconds = alternate(contestants, 3 * options.repeats, warm=2)
    scenes, agents = (len(arrays[0][name]) for name in ("sizes", "observed"))
    table = rows(f"{scenes} scenes, {agents} agents, best of 20", seconds)
    work = _work(arrays[0], discriminator=True) + _work(arrays[1], discriminator=False)
    return {
        "title": "a training iteration",
        "rows": table,
        "light": limit(work, machine_rates(), table[0]["median"]),
    }


def _work(array: dict[str, np.ndarray], *, discriminator: bool) -> Work:
    """Return the work of one network's step."""
    from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig

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
    # All 20 are decoded; the best and the one that is judged once more, with a gradient.
    decoded = decoding(config, agents, 20) + _with_gradient(decoding(config, agents, 2))
    return _with_gradient(context) + decoded + _with_gradient(judged)


def _with_gradient(forward: Work) -> Work:
    """A product has two in its gradient; tanh and sigmoid need only what they gave."""
    return forward._replace(flops=3 * forward.flops)


def read_batches(data: Path):
    """Two batches (one for each network) of 64 scenes, groups by bucket, as training reads them."""
    from neurosym_jax.data.sources import open_source
    from neurosym_jax.data.windows import cut_windows
    from neurosym_jax.training.recipe import RECIPES
    from neurosym_jax.training.stream import SceneStream

    windows = cut_windows(open_source(data).recordings("zara1", "train"), 8, 8)
    return SceneStream(windows, RECIPES["sgan"].batch_scenes, seed=0).steps(0, 2)


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
    arrays["future_moves"] = np.diff(np.concatenate([start, arrays["future"]], axis=1), axis=1)
    return arrays


def ours(batches) -> Callable[[], None]:
    """One call of the compiled step, on batches that lie on the device."""
    import jax

    from neurosym_jax.models.config import GeneratorConfig
    from neurosym_jax.training.recipe import RECIPES
    from neurosym_jax.training.step import initial_state, train_step

    generator, config = GeneratorConfig(), RECIPES["sgan"]
    batches = jax.device_put(batches)
    key = jax.random.key(0)
    state = jax.jit(lambda: initial_state(generator, config, key))()
    step = jax.jit(
        lambda state, key: train_step(generator, config, state, batches, key), donate_argnums=0
    )

    def iterate() -> None:
        nonlocal state
        state, _ = step(state, jax.random.fold_in(key, state.step))
        jax.block_until_ready(state)

    return iterate


def peer(arrays) -> Callable[[], None]:
    """Our own torch, see `torch_peer`; its two steps take the two batches."""
    from benchmarks.torch_peer import TorchPeer

    wanted = ("observed", "moves", "future_moves", "sizes")
    first, second = (
        TorchPeer(*[array[name] for name in wanted], best_k=20, clip=2.0) for array in arrays
    )

    def iterate() -> None:
        first.discriminator_step()
        second.generator_step()

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
        train.generator_step(args, second, generator, discriminator, train.gan_g_loss, g_optimizer)

    return iterate


def _collated(array: dict[str, np.ndarray]):
    """A batch as the original's loader hands it over: time first, scenes as (start, end)."""
    import torch

    agents, steps = len(array["observed"]), 16
    ends = np.cumsum(array["sizes"])
    names = ("observed", "future", "moves", "future_moves")
    tracks = [torch.as_tensor(array[name]).transpose(0, 1).contiguous() for name in names]
    bounds = torch.as_tensor(np.stack([ends - array["sizes"], ends], axis=1))
    return [*tracks, torch.zeros(agents), torch.ones(agents, steps), bounds]
