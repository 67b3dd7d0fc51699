"""SGAN's training iteration and evaluation in torch, as batched as it allows: a fair opponent.

It encodes and pools once for all samples, decodes the samples together, and treats all
pairs of all scenes (in an evaluation, of a few hundred agents) at once instead of
looping over scenes; the loss and the networks are SGAN's. It exists to be timed and
trains nothing that is kept.
"""

import itertools
import random
from typing import Any

import torch
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits

__all__ = [
    "Chunk",
    "Generator",
    "TorchForecaster",
    "TorchPeer",
    "chunks_of",
    "finish",
    "use_accelerator",
]

CHUNK = 512
"""Agents at once: the fastest of 128, 256, 512, 1024 and 4096 on two cores."""
CHUNK_ON_GPU = 8192
"""Agents at once where there is a GPU."""
EMBEDDING, HIDDEN, D_HIDDEN, MLP, POOL, BOTTLENECK, NOISE = 16, 32, 48, 64, 512, 8, 8


def use_accelerator() -> None:
    """Make all tensors from now on where torch is fastest: on a GPU, if there is one."""
    if torch.cuda.is_available():
        torch.set_default_device("cuda")


def finish() -> None:
    """Wait for what a GPU still computes."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def _mlp(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for pair in itertools.pairwise(sizes):
        layers += [nn.Linear(*pair), nn.ReLU()]
    return nn.Sequential(*layers)


def pairs_of(sizes: torch.Tensor) -> torch.Tensor:
    """[2, P] all ordered pairs (i, j) of agents of the same scene, each with itself too."""
    repeats = torch.repeat_interleave(sizes, sizes)
    i = torch.repeat_interleave(torch.arange(len(repeats)), repeats)
    first = torch.repeat_interleave(sizes.cumsum(0) - sizes, sizes)
    start = torch.repeat_interleave(repeats.cumsum(0) - repeats, repeats)
    j = first[i] + torch.arange(len(i)) - start
    return torch.stack([i, j])


class _Pooling(nn.Module):
    """The maximum over the scene's agents of a perceptron of offset and hidden state."""

    def __init__(self, hidden: int, out: int):
        super().__init__()
        self.embedding = nn.Linear(2, EMBEDDING)
        self.mlp = _mlp(EMBEDDING + hidden, POOL, out)

    def forward(self, hidden, position, pairs):
        i, j = pairs
        offset = self.embedding(position[j] - position[i])
        values = self.mlp(torch.cat([offset, hidden[j]], dim=1))
        index = i[:, None].expand_as(values)
        # Every layer ends in ReLU, so zero is the least value there is.
        start = values.new_zeros(len(hidden), values.shape[1])
        return start.scatter_reduce(0, index, values, "amax")


class _Encoder(nn.Module):
    def __init__(self, hidden: int):
        super().__init__()
        self.embedding = nn.Linear(2, EMBEDDING)
        self.lstm = nn.LSTM(EMBEDDING, hidden)

    def forward(self, moves):
        return self.lstm(self.embedding(moves))[1][0][0]


class Generator(nn.Module):
    """SGAN's, with pooling once or without."""

    def __init__(self, pred_len: int, pooling: bool = True):
        """The published sizes, and torch's initial weights."""
        super().__init__()
        self.pred_len = pred_len
        self.encoder = _Encoder(HIDDEN)
        self.pooling = _Pooling(HIDDEN, BOTTLENECK) if pooling else None
        self.context = _mlp(HIDDEN + BOTTLENECK * pooling, MLP, HIDDEN - NOISE)
        self.embedding = nn.Linear(2, EMBEDDING)
        self.cell = nn.LSTMCell(EMBEDDING, HIDDEN)
        self.out = nn.Linear(HIDDEN, 2)

    def forward(self, moves, last, pairs, noise):
        """`moves [T, A, 2]`, `noise [k, A, 8]` to displacements `[k, A, pred_len, 2]`."""
        hidden = self.encoder(moves)
        if self.pooling is not None:
            hidden = torch.cat([hidden, self.pooling(hidden, last, pairs)], dim=1)
        context = self.context(hidden)
        samples, agents, _ = noise.shape
        hidden = torch.cat([context.expand(samples, -1, -1), noise], dim=2).flatten(
            0, 1
        )
        cell = torch.zeros_like(hidden)
        move = moves[-1].expand(samples, -1, -1).flatten(0, 1)
        steps = []
        for _ in range(self.pred_len):
            hidden, cell = self.cell(self.embedding(move), (hidden, cell))
            move = self.out(hidden)
            steps.append(move)
        return torch.stack(steps, dim=1).unflatten(0, (samples, agents))

    def load_original(self, state: dict[str, torch.Tensor]) -> None:
        """Take the weights of a published checkpoint's `g_state`."""
        names = {
            "encoder.spatial_embedding.": "encoder.embedding.",
            "encoder.encoder.": "encoder.lstm.",
            "decoder.spatial_embedding.": "embedding.",
            "decoder.hidden2pos.": "out.",
            "decoder.decoder.": "cell.",
            "pool_net.spatial_embedding.": "pooling.embedding.",
            "pool_net.mlp_pre_pool.": "pooling.mlp.",
            "mlp_decoder_context.": "context.",
        }
        mine = {}
        for name, value in state.items():
            for foreign, own in names.items():
                if name.startswith(foreign):
                    rest = name.removeprefix(foreign)
                    mine[
                        own + (rest.removesuffix("_l0") if own == "cell." else rest)
                    ] = value
        self.load_state_dict(mine)


class _Discriminator(nn.Module):
    def __init__(self):
        super().__init__()
        self.encoder, self.pooling = _Encoder(D_HIDDEN), _Pooling(D_HIDDEN, D_HIDDEN)
        self.classifier = _mlp(D_HIDDEN, MLP, 1)

    def forward(self, moves, first, pairs):
        return self.classifier(self.pooling(self.encoder(moves), first, pairs))[:, 0]


class TorchPeer:
    """Networks, optimisers and one batch; `discriminator_step` and `generator_step` train."""

    def __init__(self, observed, moves, future_moves, sizes, best_k: int, clip: float):
        """`observed`, `moves` [A, obs_len, 2], `future_moves` [A, pred_len, 2], agents by scene."""
        observed, moves, future = map(torch.as_tensor, (observed, moves, future_moves))
        self.first, self.last = observed[:, 0], observed[:, -1]
        self.moves, self.future = moves.transpose(0, 1).contiguous(), future
        self.sizes = torch.as_tensor(sizes)
        self.scene = torch.repeat_interleave(torch.arange(len(sizes)), self.sizes)
        self.pairs = pairs_of(self.sizes)
        self.best_k, self.clip = best_k, clip
        self.generator, self.discriminator = (
            Generator(future.shape[1]),
            _Discriminator(),
        )
        for module in (*self.generator.modules(), *self.discriminator.modules()):
            if isinstance(module, nn.Linear):
                nn.init.kaiming_normal_(module.weight)
        self.g_optimizer = torch.optim.Adam(self.generator.parameters(), lr=1e-4)
        self.d_optimizer = torch.optim.Adam(self.discriminator.parameters(), lr=1e-3)

    def discriminator_step(self) -> None:
        """One Adam step of the discriminator."""
        with torch.no_grad():
            fake = self._forecast(1)[0]
        real_scores, fake_scores = self._scores(self.future), self._scores(fake)
        label = torch.full_like(real_scores, random.uniform(0.7, 1.2))
        loss = binary_cross_entropy_with_logits(real_scores, label)
        loss = loss + binary_cross_entropy_with_logits(
            fake_scores, torch.zeros_like(label)
        )
        self.d_optimizer.zero_grad()
        loss.backward()
        self.d_optimizer.step()

    def generator_step(self) -> None:
        """One Adam step of the generator on the best of k, scene by scene, and the last sample."""
        fakes = self._forecast(self.best_k)
        errors = ((fakes - self.future) ** 2).sum(dim=(2, 3))
        total = errors.new_zeros(self.best_k, len(self.sizes)).index_add(
            1, self.scene, errors
        )
        variety = (total.min(dim=0).values / (self.sizes * self.future.shape[1])).sum()
        scores = self._scores(fakes[-1])
        label = torch.full_like(scores, random.uniform(0.7, 1.2))
        loss = variety + binary_cross_entropy_with_logits(scores, label)
        self.g_optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.generator.parameters(), self.clip)
        self.g_optimizer.step()

    def _forecast(self, samples: int):
        noise = torch.randn(samples, len(self.sizes), NOISE)[:, self.scene]
        return self.generator(self.moves, self.last, self.pairs, noise)

    def _scores(self, future_moves):
        moves = torch.cat([self.moves, future_moves.transpose(0, 1)])
        return self.discriminator(moves, self.first, self.pairs)


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
            error = torch.linalg.vector_norm(
                self.forecast(chunk, samples) - chunk.future, dim=3
            )
            ade += self._best(error.mean(2), chunk)
            fde += self._best(error[..., -1], chunk)
            agents += len(chunk.scene)
        return ade / agents, fde / agents

    @staticmethod
    def _best(error: torch.Tensor, chunk: "Chunk") -> float:
        """Sum over scenes of the least of the samples' summed `error [k, A]`."""
        total = error.new_zeros(len(error), len(chunk.sizes))
        return total.index_add(1, chunk.scene, error).min(0).values.sum().item()

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
        observed, self.future = (
            torch.as_tensor(part).float() for part in (observed, future)
        )
        self.sizes = torch.as_tensor(sizes)
        self.scene = torch.repeat_interleave(torch.arange(len(sizes)), self.sizes)
        self.last = observed[:, -1].contiguous()
        moves = torch.diff(observed, dim=1, prepend=observed[:, :1])
        self.moves = moves.transpose(0, 1).contiguous()
        self.pairs = pairs_of(self.sizes)


def chunks_of(windows: Any) -> list[Chunk]:
    """The scenes of `Windows`, at least `CHUNK` agents in each chunk but the last."""
    agents = CHUNK_ON_GPU if torch.cuda.is_available() else CHUNK
    chunks, first = [], 0
    for last in range(1, windows.scenes + 1):
        start, end = windows.bounds[first], windows.bounds[last]
        if end - start >= agents or last == windows.scenes:
            position = windows.position[start:end]
            observed = windows.obs_len
            sizes = windows.sizes[first:last]
            chunks.append(Chunk(position[:, :observed], position[:, observed:], sizes))
            first = last
    return chunks
