"""SGAN's best-of-k evaluation in torch, written as batched as torch allows: a fair opponent.

Scenes are taken a few hundred agents at a time, encoding and pooling are done once for all samples,
the samples are decoded together, and errors are summed without a loop over scenes.
"""

from typing import Any

import torch

from benchmarks.torch_peer import Generator, pairs_of

CHUNK = 512
"""Agents at once: the fastest of 128, 256, 512, 1024 and 4096 on two cores."""


class TorchForecaster:
    """A generator that forecasts."""

    def __init__(self, generator: Generator):
        """`generator` with its weights."""
        self.generator = generator.eval()

    @classmethod
    def of(cls, checkpoint: dict[str, Any]) -> "TorchForecaster":
        """Build the network from a published checkpoint as `torch.load` returns it."""
        pooling = checkpoint["args"]["pooling_type"] == "pool_net"
        generator = Generator(checkpoint["args"]["pred_len"], pooling)
        generator.load_original(checkpoint["g_state"])
        return cls(generator)

    @torch.inference_mode()
    def evaluate(self, chunks: "list[Chunk]", samples: int) -> tuple[float, float]:
        """Joint best-of-k ADE and FDE in metres."""
        ade = fde = agents = 0.0
        for chunk in chunks:
            error = torch.linalg.vector_norm(self.forecast(chunk, samples) - chunk.future, dim=3)
            ade += self._best(error.mean(2), chunk)
            fde += self._best(error[..., -1], chunk)
            agents += len(chunk.scene)
        return ade / agents, fde / agents

    @staticmethod
    def _best(error: torch.Tensor, chunk: "Chunk") -> float:
        """Sum over scenes of the least of the samples' summed `error [k, A]`."""
        of_scene = error.new_zeros(len(error), len(chunk.sizes))
        return of_scene.index_add(1, chunk.scene, error).min(0).values.sum().item()

    @torch.inference_mode()
    def forecast(self, chunk: "Chunk", samples: int) -> torch.Tensor:
        """`[k, A, pred_len, 2]` metres."""
        noise = torch.randn(samples, len(chunk.sizes), 8)[:, chunk.scene]
        moves = self.generator(chunk.moves, chunk.last, chunk.pairs, noise)
        return chunk.last[:, None] + moves.cumsum(2)


class Chunk:
    """Some scenes of a test set, agent by agent."""

    def __init__(self, observed: Any, future: Any, sizes: Any):
        """`observed [A, obs_len, 2]`, `future [A, pred_len, 2]` metres, agents of each scene."""
        observed, self.future = (torch.as_tensor(part).float() for part in (observed, future))
        self.sizes = torch.as_tensor(sizes)
        self.scene = torch.repeat_interleave(torch.arange(len(sizes)), self.sizes)
        self.last = observed[:, -1].contiguous()
        moves = torch.diff(observed, dim=1, prepend=observed[:, :1])
        self.moves = moves.transpose(0, 1).contiguous()
        self.pairs = pairs_of(self.sizes)


def chunks_of(windows: Any, agents: int = CHUNK) -> list[Chunk]:
    """The scenes of `Windows`, at least `agents` agents in each chunk but the last."""
    found, first = [], 0
    for last in range(1, windows.scenes + 1):
        start, end = windows.bounds[first], windows.bounds[last]
        if end - start >= agents or last == windows.scenes:
            position = windows.position[start:end]
            observed = windows.obs_len
            sizes = windows.sizes[first:last]
            found.append(Chunk(position[:, :observed], position[:, observed:], sizes))
            first = last
    return found
