"""What `neurosym golden` runs in an interpreter that has torch: SGAN's own code forecasts.

It is a script of its own, for any Python from 3.7 on: nothing of the package imports it, and it
imports nothing of the package, so that what it saves is torch's alone. Its argument is JSON:
`checkout` (the folder that has SGAN's `sgan` package), `checkpoints`, `out` (a folder that is
there) and `seed`.
"""

import importlib
import inspect
import json
import os
import sys

import numpy as np

__all__ = ["main"]

SIZES = (3, 2, 1, 5)
"""People in each scene: of a scene of more than two the first one stands still."""

SMALL = {
    "embedding_dim": 4,
    "encoder_h_dim": 8,
    "decoder_h_dim": 8,
    "mlp_dim": 16,
    "bottleneck_dim": 8,
    "num_layers": 1,
    "noise_dim": (2,),
    "noise_type": "gaussian",
    "dropout": 0.0,
    "neighborhood_size": 2.0,
    "grid_size": 4,
    "batch_norm": False,
    "obs_len": 8,
}
FRESH = {
    "fresh_none": (None, False, 8, "local"),
    "fresh_pool_net": ("pool_net", True, 12, "global"),
    "fresh_spool": ("spool", True, 8, "local"),
}
"""Networks with weights as torch draws them: pooling, whether at every step that is forecast, how
many those are, and the discriminator's kind."""


def main(given):
    """Write `manifest.json` and a case for each checkpoint, else for each of `FRESH`."""
    sys.path.insert(0, given["checkout"])
    torch = importlib.import_module("torch")
    models = importlib.import_module("sgan.models")
    _stay_on_the_cpu(torch)
    rows = []
    cases = given["checkpoints"] or FRESH
    for number, case in enumerate(cases):
        torch.manual_seed(given["seed"] + number)
        rng = np.random.RandomState(given["seed"] + number)
        make = _of_checkpoint if given["checkpoints"] else _fresh
        name, arguments, generator, discriminator, more = make(torch, models, case)
        arrays = _forecast(torch, generator, discriminator, arguments, rng)
        if any(row["file"] == name + ".npz" for row in rows):
            name = f"{name}_{number}"
        np.savez_compressed(os.path.join(given["out"], name + ".npz"), **arrays)
        row = {"file": name + ".npz", "model": "sgan"}
        row.update(arguments)
        row.update(more)
        rows.append(row)
    with open(os.path.join(given["out"], "manifest.json"), "w") as file:
        json.dump(rows, file, indent=1)
        file.write("\n")


def _stay_on_the_cpu(torch):
    """The released code moves its states to a CUDA device."""

    def stay(self, *_, **__):
        return self

    torch.Tensor.cuda = torch.nn.Module.cuda = stay


def _of_checkpoint(torch, models, path):
    """Name, arguments, networks and manifest fields of what SGAN's training wrote."""
    # Where this torch can, it reads no more than weights.
    safely = "weights_only" in inspect.signature(torch.load).parameters
    options = {"weights_only": True} if safely else {}
    contents = torch.load(path, map_location="cpu", **options)
    given = contents["args"]
    arguments = {name: given[name] for name in (*SMALL, "pred_len") if name in given}
    for name in ("encoder_h_dim", "decoder_h_dim"):
        arguments[name] = given[name + "_g"]
    for name in ("noise_mix_type", "pooling_type", "pool_every_timestep"):
        arguments[name] = given[name]
    generator = models.TrajectoryGenerator(**arguments)
    generator.load_state_dict(contents["g_state"])
    discriminator, more = None, {}
    if contents.get("d_state") is not None:
        more = {"d_type": given["d_type"], "encoder_h_dim_d": given["encoder_h_dim_d"]}
        discriminator = _discriminator(models, arguments, more)
        discriminator.load_state_dict(contents["d_state"])
    folder, file = os.path.split(os.path.abspath(path))
    name = f"{os.path.basename(folder)}_{os.path.splitext(file)[0]}"
    return name, arguments, generator, discriminator, more


def _fresh(torch, models, name):
    """As `_of_checkpoint`, with weights that were just drawn."""
    pooling, always, pred_len, d_type = FRESH[name]
    arguments = dict(SMALL, pooling_type=pooling, pool_every_timestep=always, pred_len=pred_len)
    arguments["noise_mix_type"] = "ped" if d_type == "global" else "global"
    more = {"d_type": d_type, "encoder_h_dim_d": 8}
    generator = models.TrajectoryGenerator(**arguments)
    discriminator = _discriminator(models, arguments, more)
    with torch.no_grad():
        # Its last layer ends in a ReLU: scores of zero would agree with anything of zero.
        discriminator.real_classifier[-2].bias += 0.5
    return name, arguments, generator, discriminator, more


def _discriminator(models, arguments, more):
    names = ("obs_len", "pred_len", "embedding_dim", "mlp_dim")
    names += ("num_layers", "dropout", "batch_norm")
    return models.TrajectoryDiscriminator(
        h_dim=more["encoder_h_dim_d"],
        d_type=more["d_type"],
        **{name: arguments[name] for name in names if name in arguments},
    )


def _forecast(torch, generator, discriminator, arguments, rng):
    """The arrays of a case: weights, scenes of people who walk at random, what comes of them."""
    observed, steps = arguments["obs_len"], arguments["obs_len"] + arguments["pred_len"]
    ends = np.cumsum(SIZES)
    bounds = np.stack([ends - SIZES, ends], 1)
    walks = rng.normal(0, 4, (ends[-1], 1, 2))
    walks = walks + np.cumsum(rng.normal(0, 0.3, (ends[-1], steps, 2)), 1)
    for start, end in bounds:
        if end - start > 2:
            walks[start] = walks[start, :1]
    walks = walks.round(4)
    moves = np.diff(walks, axis=1, prepend=walks[:, :1])
    dim = tuple(arguments["noise_dim"])
    rows = len(bounds) if arguments["noise_mix_type"] == "global" else len(walks)
    noise = rng.normal(size=(rows, *dim)).astype(np.float32)

    def time_first(array):
        return torch.tensor(array, dtype=torch.float32).transpose(0, 1).contiguous()

    seen, seen_moves = time_first(walks[:, :observed]), time_first(moves[:, :observed])
    scenes = torch.tensor(bounds)
    arrays = {
        "traj": walks.astype(np.float32),
        "traj_rel": moves.astype(np.float32),
        "scene_start_end": bounds,
        "noise": noise,
    }
    with torch.no_grad():
        generator.eval()
        forecast = generator(seen, seen_moves, scenes, user_noise=torch.tensor(noise))
        positions = seen[-1] + forecast.cumsum(dim=0)
        arrays["pred_rel"] = forecast.transpose(0, 1).numpy()
        arrays["pred_abs"] = positions.transpose(0, 1).numpy()
        arrays.update(_weights("g_state/", generator))
        if discriminator is not None:
            discriminator.eval()
            whole = torch.cat([seen, positions]), torch.cat([seen_moves, forecast])
            arrays["d_scores_fake"] = discriminator(*whole, scenes).flatten().numpy()
            arrays.update(_weights("d_state/", discriminator))
    return arrays


def _weights(prefix, network):
    return {prefix + name: value.numpy() for name, value in network.state_dict().items()}


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
