"""SGAN in torch, as its paper describes it, with the released code's names and arguments.

Tests change a line of it, as users change the original, and see what loading and parity
say.
"""

import functools
from itertools import pairwise

import torch
from torch import nn


def make_mlp(sizes, dropout=0.0):
    layers = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
        if dropout > 0:
            layers.append(nn.Dropout(dropout))
    return nn.Sequential(*layers)


class Encoder(nn.Module):
    def __init__(self, embedding_dim, h_dim):
        super().__init__()
        self.encoder = nn.LSTM(embedding_dim, h_dim)
        self.spatial_embedding = nn.Linear(2, embedding_dim)

    def forward(self, moves):
        _, (hidden, _) = self.encoder(self.spatial_embedding(moves))
        return hidden


class PoolHiddenNet(nn.Module):
    def __init__(self, embedding_dim, h_dim, bottleneck_dim, dropout):
        super().__init__()
        self.spatial_embedding = nn.Linear(2, embedding_dim)
        self.mlp_pre_pool = make_mlp(
            [embedding_dim + h_dim, 512, bottleneck_dim], dropout
        )

    def forward(self, hidden, bounds, position):
        hidden, pooled = hidden.reshape(-1, hidden.shape[-1]), []
        for start, end in bounds.tolist():
            h, p = hidden[start:end], position[start:end]
            offsets = self.spatial_embedding((p[None] - p[:, None]).reshape(-1, 2))
            pairs = torch.cat([offsets, h.repeat(len(h), 1)], dim=1)
            pooled.append(
                self.mlp_pre_pool(pairs).reshape(len(h), len(h), -1).max(1)[0]
            )
        return torch.cat(pooled)


class Decoder(nn.Module):
    def __init__(self, pred_len, embedding_dim, h_dim, pool_net, mlp):
        super().__init__()
        self.pred_len = pred_len
        self.decoder = nn.LSTM(embedding_dim, h_dim)
        self.pool_net, self.mlp = pool_net, mlp
        self.spatial_embedding = nn.Linear(2, embedding_dim)
        self.hidden2pos = nn.Linear(h_dim, 2)

    def forward(self, position, move, state, bounds):
        moves = []
        for _ in range(self.pred_len):
            _, state = self.decoder(self.spatial_embedding(move)[None], state)
            move = self.hidden2pos(state[0][0])
            position = position + move
            if self.pool_net is not None:
                pooled = self.pool_net(state[0], bounds, position)
                state = (
                    self.mlp(torch.cat([state[0][0], pooled], dim=1))[None],
                    state[1],
                )
            moves.append(move)
        return torch.stack(moves)


class TrajectoryGenerator(nn.Module):
    def __init__(
        self, obs_len, pred_len, embedding_dim=64, encoder_h_dim=64,
        decoder_h_dim=128, mlp_dim=1024, num_layers=1, noise_dim=(0,),
        noise_type="gaussian", noise_mix_type="ped", pooling_type=None,
        pool_every_timestep=True, dropout=0.0, bottleneck_dim=1024,
        neighborhood_size=2.0, grid_size=8,
    ):  # fmt: skip
        super().__init__()
        self.obs_len, self.pred_len = obs_len, pred_len
        self.noise_mix_type, self.noise_dim = noise_mix_type, noise_dim[0]
        pooling_type = None if pooling_type == "none" else pooling_type
        self.encoder = Encoder(embedding_dim, encoder_h_dim)
        pooling = functools.partial(
            PoolHiddenNet, embedding_dim, bottleneck_dim=bottleneck_dim, dropout=dropout
        )
        always = pooling_type is not None and pool_every_timestep
        widths = [decoder_h_dim + bottleneck_dim, mlp_dim, decoder_h_dim]
        self.decoder = Decoder(
            pred_len, embedding_dim, decoder_h_dim,
            pooling(decoder_h_dim) if always else None,
            make_mlp(widths, dropout) if always else None,
        )  # fmt: skip
        self.pool_net = pooling(encoder_h_dim) if pooling_type else None
        pooled = bottleneck_dim if pooling_type else 0
        self.needs_mlp = bool(
            self.noise_dim or pooled or encoder_h_dim != decoder_h_dim
        )
        if self.needs_mlp:
            widths = [encoder_h_dim + pooled, mlp_dim, decoder_h_dim - self.noise_dim]
            self.mlp_decoder_context = make_mlp(widths, dropout)

    def add_noise(self, context, bounds, noise):
        if self.noise_dim and self.noise_mix_type == "global":
            noise = torch.repeat_interleave(noise, bounds[:, 1] - bounds[:, 0], dim=0)
        return torch.cat([context, noise], dim=1) if self.noise_dim else context

    def forward(self, obs_traj, obs_traj_rel, seq_start_end, user_noise=None):
        hidden = self.encoder(obs_traj_rel)
        context = hidden[-1]
        if self.pool_net is not None:
            pooled = self.pool_net(hidden, seq_start_end, obs_traj[-1])
            context = torch.cat([context, pooled], dim=1)
        if self.needs_mlp:
            context = self.mlp_decoder_context(context)
        start = self.add_noise(context, seq_start_end, user_noise)[None]
        state = start, torch.zeros_like(start)
        return self.decoder(obs_traj[-1], obs_traj_rel[-1], state, seq_start_end)


class TrajectoryDiscriminator(nn.Module):
    def __init__(
        self, obs_len, pred_len, embedding_dim=64, h_dim=64, mlp_dim=1024,
        num_layers=1, dropout=0.0, d_type="local",
    ):  # fmt: skip
        super().__init__()
        self.encoder = Encoder(embedding_dim, h_dim)
        self.real_classifier = make_mlp([h_dim, mlp_dim, 1], dropout)
        if d_type == "global":
            self.pool_net = PoolHiddenNet(embedding_dim, h_dim, h_dim, dropout)
        self.is_global = d_type == "global"

    def forward(self, traj, traj_rel, seq_start_end=None):
        hidden = self.encoder(traj_rel)
        features = hidden.squeeze()
        if self.is_global:
            features = self.pool_net(features, seq_start_end, traj[0])
        return self.real_classifier(features)
