"""NeuroSyM in torch by its releases' names and arguments, after the text of `sgan_torch.py`.

`MixedHistory` is the robot package's pooling, `NoHistory` the first release's.
"""

# The text is read after that of sgan_torch.py.
# ruff: noqa: F821
# pyright: reportUndefinedVariable=false


class InformedPooling(nn.Module):
    def __init__(self, obs_len, embedding_dim, h_dim, bottleneck_dim, steps):
        super().__init__()
        self.embedding_dim = embedding_dim
        self.spatial_embedding = nn.Linear(2 * steps, embedding_dim * steps)
        self.mlp_pre_pool = make_mlp(
            [obs_len * embedding_dim + h_dim, 512, bottleneck_dim]
        )

    def forward(self, hidden, bounds, traj, weight):
        pooled = []
        for scene, (start, end) in enumerate(bounds.tolist()):
            h, tracks = hidden[-1, start:end], traj[:, start:end].permute(1, 0, 2)
            embedded = self.embed(tracks, weight, scene, start, end).flatten(1)
            pairs = torch.cat([embedded, h.repeat(len(h), 1)], dim=1)
            pooled.append(
                self.mlp_pre_pool(pairs).reshape(len(h), len(h), -1).max(1)[0]
            )
        return torch.cat(pooled)


class MixedHistory(InformedPooling):
    def embed(self, tracks, weight, scene, start, end):
        offsets = (tracks[None] - tracks[:, None]).flatten(0, 1).flatten(1)
        shares = weight[scene].permute(0, 2, 1).repeat(1, 1, self.embedding_dim)
        return shares.flatten(1).cuda() * self.spatial_embedding(offsets)


class NoHistory(InformedPooling):
    def embed(self, tracks, weight, scene, start, end):
        rows = weight.permute(1, 0, 2)[start:end].repeat(1, 1, self.embedding_dim)
        nothing = torch.zeros_like(tracks).repeat(len(tracks), 1, 1)
        return rows.repeat(len(tracks), 1, 1) * self.spatial_embedding(nothing)


class InformedGenerator(TrajectoryGenerator):
    pooling = MixedHistory

    def __init__(
        self, obs_len, pred_len, embedding_dim, encoder_h_dim, decoder_h_dim,
        mlp_dim, noise_dim, noise_mix_type, pooling_type, bottleneck_dim,
    ):  # fmt: skip
        super().__init__(
            obs_len, pred_len, embedding_dim, encoder_h_dim, decoder_h_dim, mlp_dim,
            noise_dim=noise_dim, noise_mix_type=noise_mix_type,
            pooling_type=pooling_type, bottleneck_dim=bottleneck_dim,
            pool_every_timestep=False,
        )  # fmt: skip
        steps = obs_len if self.pooling is MixedHistory else 1
        self.pool_net = None
        self.pool_net_d = PoolHiddenNet(
            embedding_dim, encoder_h_dim, bottleneck_dim, 0.0
        )
        self.pool_net_g = self.pooling(
            obs_len, embedding_dim, encoder_h_dim, bottleneck_dim, steps
        )

    def forward(self, traj, traj_rel, traj_weight, seq_start_end, user_noise=None):
        hidden = self.encoder(traj_rel)
        pooled = self.pool_net_g(hidden, seq_start_end, traj, traj_weight)
        context = self.mlp_decoder_context(torch.cat([hidden[-1], pooled], dim=1))
        start = self.add_noise(context, seq_start_end, user_noise)[None]
        state = start, torch.zeros_like(start).cuda()
        return self.decoder(traj[-1], traj_rel[-1], state, seq_start_end)


class FirstRelease(InformedGenerator):
    pooling = NoHistory


class InformedDiscriminator(TrajectoryDiscriminator):
    def forward(self, traj, traj_rel, traj_weight, seq_start_end=None):
        return super().forward(traj, traj_rel, seq_start_end)
