"""Seconds of one discriminator and one generator step of recipe `sgan`: ours beside torch's.

Everybody trains on the same 64 scenes of zara1's training split (about 780 agents), best of 20,
8 + 8 steps, with the published sizes. The opponents are `torch_peer` and, with `--reference`, the
original code, whose own step functions and networks are run on the CPU. Rounds alternate between
the contestants, so that what else the machine does falls on all of them.

    python benchmarks/train_step.py --data ../shared/data/eth_ucy [--reference PATH] [--json FILE]
"""

import argparse
import importlib.util
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np


def main() -> None:
    """Measure, print a table, write JSON where asked to."""
    parser = argparse.ArgumentParser(description="Time a training step of ours beside torch's.")
    parser.add_argument("--data", type=Path, required=True, help="ETH/UCY as SGAN arranges it")
    parser.add_argument("--reference", type=Path, help="a checkout of SGAN (agrimgupta92/sgan)")
    parser.add_argument("--rounds", type=int, default=10, help="measured iterations of each")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="of each contestant")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    options = parser.parse_args()
    if importlib.util.find_spec("torch") is None:
        sys.exit("error: torch is missing, and there is nobody to compare with: pip install torch")
    if options.reference and not (options.reference / "scripts" / "train.py").is_file():
        sys.exit(f"error: {options.reference}: no checkout of SGAN: it has no scripts/train.py")
    os.environ["NPROC"] = str(options.threads)  # Before jax is imported.

    batches = read_batches(options.data)
    contestants = {"neurosym_jax": ours(batches)}
    arrays = [unpadded(batches, index) for index in (0, 1)]
    contestants["torch peer"] = peer(arrays, options.threads)
    if options.reference:
        contestants["original"] = original(arrays, options.reference)
    agents = [len(array["observed"]) for array in arrays]
    seconds = measure(contestants, options.rounds)

    medians = {name: statistics.median(times) for name, times in seconds.items()}
    scenes = len(arrays[0]["sizes"])
    print(f"{scenes} scenes, {agents[0]} and {agents[1]} agents, {options.threads} threads")
    print(f"one discriminator and one generator step, median of {options.rounds}:")
    for name, times in seconds.items():
        ratio = medians[name] / medians["neurosym_jax"]
        spread = f"{min(times):.3f} to {max(times):.3f}"
        print(f"  {name:14} {medians[name]:7.3f} s  ({spread})  {ratio:5.1f} times ours")
    if options.json:
        result = {
            "format": 1,
            "scenes": scenes,
            "agents": agents,
            "threads": options.threads,
            "machine": platform.machine(),
            "seconds": seconds,
            "median": medians,
            "ratio": {name: m / medians["neurosym_jax"] for name, m in medians.items()},
        }
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def read_batches(data: Path):
    """Two batches (one for each network) of 64 scenes, groups by bucket, as training reads them."""
    from neurosym_jax.config import RECIPES
    from neurosym_jax.data.sources import open_source
    from neurosym_jax.data.windows import cut_windows
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

    from neurosym_jax.config import RECIPES, GeneratorConfig
    from neurosym_jax.runtime import enable_compilation_cache
    from neurosym_jax.training.step import initial_state, train_step

    enable_compilation_cache()
    generator, config = GeneratorConfig(), RECIPES["sgan"]
    batches = jax.device_put(batches)
    example = jax.tree.map(lambda leaf: leaf[0, 0], batches[0])
    key = jax.random.key(0)
    state = jax.jit(lambda: initial_state(generator, config, example, key))()
    step = jax.jit(
        lambda state, key: train_step(generator, config, state, batches, key), donate_argnums=0
    )

    def iterate() -> None:
        nonlocal state
        state, _ = step(state, jax.random.fold_in(key, state.step))
        jax.block_until_ready(state)

    return iterate


def peer(arrays, threads: int) -> Callable[[], None]:
    """Our own torch, see `torch_peer`; its two steps take the two batches."""
    import torch
    from torch_peer import TorchPeer

    torch.set_num_threads(threads)
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

    torch.Tensor.cuda = lambda self, *args, **kwargs: self  # It calls .cuda() unasked.
    sys.path.insert(0, str(reference))
    spec = importlib.util.spec_from_file_location("sgan_train", reference / "scripts" / "train.py")
    assert spec is not None
    assert spec.loader is not None
    train = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(train)
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


def measure(contestants: dict[str, Callable[[], None]], rounds: int) -> dict[str, list[float]]:
    """Seconds of each round of each contestant, after two that are not counted."""
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for number in range(rounds + 2):
        for name, iterate in contestants.items():
            start = time.perf_counter()
            iterate()
            if number >= 2:
                seconds[name].append(time.perf_counter() - start)
    return seconds


if __name__ == "__main__":
    main()
