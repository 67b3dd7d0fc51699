"""The anchors network, its loss and a training step in torch: an opponent of the same numbers.

All scenes of a batch go through each operation together. It starts from our parameters,
and `tests/test_benchmarks.py` holds its forecasts, its loss and its gradient to ours.
It neither augments a batch nor averages parameters, which our step does.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.functional import linear

from neurosym_jax.models.anchors.config import LONGEST, SLOW, WIDE
from neurosym_jax.models.anchors.network import (
    BASIS,
    HEADS,
    ROUGHNESS,
    AnchorConfig,
    _polynomials,
)
from neurosym_jax.models.anchors.training import AnchorRecipe

__all__ = ["TorchAnchors"]


def _length(vector: torch.Tensor, smooth: float = 1e-3) -> torch.Tensor:
    return (vector.square().sum(-1) + smooth**2).sqrt()


def _turned(vector: torch.Tensor, heading: torch.Tensor, sign: int) -> torch.Tensor:
    x, y = vector.unbind(-1)
    cos, sin = heading[..., 0], sign * heading[..., 1]
    return torch.stack([x * cos - y * sin, x * sin + y * cos], -1)


def _within(distance: torch.Tensor, radius: float) -> torch.Tensor:
    return (1 - (distance / radius).square()).clamp(min=0).square()


class TorchAnchors(nn.Module):
    """The network with a batch, whose `step` trains."""

    def __init__(
        self,
        config: AnchorConfig,
        recipe: AnchorRecipe,
        params: Mapping[str, Any],
        batch: Any,
    ):
        """`params` are Flax's, `batch` is `AnchorStream.batch`'s: scenes and their crowds."""
        super().__init__()
        self.config, self.recipe = config, recipe
        self.weight = nn.ParameterDict()
        for name, value in params["params"].items():
            arrays = value if isinstance(value, Mapping) else {"": value}
            for part, array in arrays.items():
                tensor = torch.tensor(
                    np.asarray(array).T if part == "kernel" else np.array(array)
                )
                self.weight[f"{name}{part}"] = nn.Parameter(tensor.contiguous())
        scenes, crowd = batch
        self.observed, self.future, self.valid = (
            torch.tensor(np.asarray(array))
            for array in (scenes.observed, scenes.known_future, scenes.valid)
        )
        self.crowd = torch.tensor(crowd)
        self.curve = torch.tensor(
            _polynomials(config.pred_len, BASIS), dtype=torch.float32
        )
        self.ahead = torch.arange(1, config.pred_len + 1, dtype=torch.float32)[:, None]
        self.optimizer = torch.optim.Adam(self.parameters(), lr=recipe.learning_rate)

    def step(self) -> None:
        """One Adam step on the batch."""
        loss = self.loss()
        self.optimizer.zero_grad()
        loss.backward()
        if self.recipe.clip_norm:
            nn.utils.clip_grad_norm_(self.parameters(), self.recipe.clip_norm)
        self.optimizer.step()

    def loss(self) -> torch.Tensor:
        """See `neurosym_jax.models.anchors.training.anchor_loss`."""
        recipe, size, own = self.recipe, self.valid.sum(1), self.valid.sum(1)

        def of_crowds(values: torch.Tensor) -> torch.Tensor:
            return values.new_zeros(len(size), *values.shape[1:]).index_add(
                0, self.crowd, values
            )

        people = of_crowds(own)
        forecast, log_probability = self((people[self.crowd] - own).float())
        n = people.clamp(min=1)[:, None]
        square = (forecast - self.future[:, None]).square().sum(-1)
        distance = torch.where(
            self.valid[:, None, :, None], (square + 1e-9).sqrt(), 0.0
        )
        ade = distance.mean(-1)
        error = ade + recipe.fde_weight * distance[..., -1]
        joint = of_crowds(error.sum(2))
        total = recipe.joint_weight * joint.amin(1).sum()
        total = total + recipe.marginal_weight * error.amin(1).sum()
        total = total + recipe.mean_weight * ade.mean(1).sum()
        log_probability = of_crowds(log_probability * own[:, None]) / n
        target = (-joint.detach() / n / recipe.temperature).softmax(1)
        cross = (target * log_probability).sum(1) * people
        total = total - recipe.probability_weight * cross.sum()
        likely = joint.gather(1, log_probability.argmax(1, keepdim=True))
        return (total + recipe.likely_weight * likely.sum()) / own.sum()

    def forward(self, company: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Forecasts `[B, k, N, T, 2]` and log-probabilities `[B, k]`; `company` [B] unseen."""
        config, observed, valid = self.config, self.observed, self.valid
        hertz, steps = 1 / config.period, observed.diff(dim=2)
        velocity, roughness = self._velocity(steps)
        speed = _length(velocity)
        slow = SLOW * config.period
        heading = velocity / (velocity.square().sum(-1, keepdim=True) + slow**2).sqrt()
        walking = heading.square().sum(-1)
        past = hertz * _turned(steps, heading[..., None, :], -1).flatten(2)
        speeds = torch.stack([hertz * speed, (hertz * speed).square(), walking], -1)
        own = torch.cat([past, hertz * _length(steps), speeds, roughness], -1)
        heard, crowd = self._heard(velocity * hertz, heading)
        count = torch.log1p(crowd + company[:, None])[..., None]
        state = torch.cat([self._dense("own", own).relu(), heard, count], -1)
        state = self._dense("state", state).relu()

        k = config.samples
        bend = self._dense("bend", state).unflatten(-1, (k, BASIS, 2))
        spread = self._dense("spread", state).exp()[..., None, None]
        scale = (speed * config.pred_len + 0.5)[..., None, None, None]
        heading = heading[..., None, None, :]
        residual = _turned(scale * (bend + spread * self.weight["anchor"]), heading, 1)
        standing = (1 - (walking + 1e-6).sqrt()) * (
            config.pred_len * config.period / 2.4
        )
        residual = (
            residual + standing[..., None, None, None] * spread * self.weight["still"]
        )
        residual = torch.einsum("bnkcd,tc->bkntd", residual, self.curve)
        score = torch.where(valid[..., None], self._dense("likely", state), 0.0)
        score = score.sum(1) / valid.sum(1, keepdim=True).clamp(min=1).sqrt()
        straight = observed[:, :, -1:] + velocity[:, :, None] * self.ahead
        return straight[:, None] + residual, (self.weight["prior"] + score).log_softmax(
            -1
        )

    def _velocity(self, steps: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        differences = (steps.diff(dim=2), steps.diff(n=2, dim=2), steps)
        logs = [(_length(vector) + ROUGHNESS).log() for vector in differences]
        roughness = torch.cat(logs, -1) / 2 + 1.5
        recent = torch.arange(steps.shape[2], dtype=torch.float32)
        weight = recent + self._dense("smooth", self._dense("rough", roughness).relu())
        return (weight.softmax(-1)[..., None] * steps).sum(2), roughness

    def _heard(
        self, pace: torch.Tensor, heading: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """What the attention gives `[B, N, 16]`, and the number of people around `[B, N]`."""
        position, valid, radius = (
            self.observed[:, :, -1],
            self.valid,
            self.config.radius,
        )
        offset, relative = (
            vector[:, None] - vector[:, :, None] for vector in (position, pace)
        )
        distance, speed = _length(offset), _length(pace)
        bearing, motion = (
            _turned(vector, heading[:, :, None], -1) for vector in (offset, relative)
        )
        soon = -(bearing * motion).sum(-1) / (motion.square().sum(-1) + 0.05)
        soon = soon.clamp(0, LONGEST)
        miss = _length(bearing + motion * soon[..., None])
        near = bearing / distance.clamp(min=1)[..., None]
        own, other_speed = torch.broadcast_tensors(speed[:, :, None], speed[:, None])
        alone = [
            _length(relative),
            (-distance).exp(),
            distance / radius,
            1 / (distance + 0.3),
        ]
        alone += [soon, (-2 * miss - soon).exp(), own, other_speed]
        pairs = torch.cat([near, motion, torch.stack(alone, -1)], -1)
        others = (
            valid[:, :, None]
            & valid[:, None]
            & ~torch.eye(valid.shape[1], dtype=torch.bool)
        )
        gate = torch.where(others, _within(distance, radius), 0.0)
        crowd = torch.where(others, _within(distance, WIDE), 0.0).sum(2)
        pairs = self._dense("pair", torch.where(others[..., None], pairs, 0.0)).relu()
        message = self._dense("message", pairs).unflatten(-1, (HEADS, -1))
        weight = gate[..., None] * self._dense("score", pairs).clamp(-8, 8).exp()
        share = weight / (1 + weight.sum(2, keepdim=True))
        return (share[..., None] * message).sum(2).flatten(2), crowd

    def _dense(self, name: str, inputs: torch.Tensor) -> torch.Tensor:
        return linear(inputs, self.weight[f"{name}kernel"], self.weight[f"{name}bias"])
