"""The user's torch module runs here: its inputs, the outputs of all submodules, its forecast.

`neurosym parity --torch-module` runs this file as a script in an interpreter that has
torch, any Python from 3.7 on. It imports nothing of the package, so that what it saves
is torch's alone.
"""

import copy
import functools
import importlib
import inspect
import json
import os
import sys
from unittest import mock

import numpy as np

__all__ = [
    "alpha_layouts",
    "forecast",
    "inputs",
    "main",
    "random_alpha",
    "random_walks",
]

NEEDED = (
    *("noise_type", "noise_mix_type", "noise_dim", "dropout"),
    *("pooling_type", "pool_every_timestep", "neighborhood_size", "grid_size"),
)
"""Arguments that the description of a case has, whether the constructor takes them or not."""
SIZES = (3, 2, 1, 5)
"""People in each scene: of a scene of more than two the first one stands still."""


def main(path, contents_folder, out, name, seed):
    """Write the case of a checkpoint in the class `name` of the file `path`, and its manifest.

    `contents_folder` holds what our reader read of the checkpoint (see
    `parity.hand_over`). The file itself is not opened here: a second parser might read
    another program in it than the one that was checked.
    """
    torch = importlib.import_module("torch")
    folder, file = os.path.split(os.path.splitext(os.path.abspath(path))[0])
    while os.path.isfile(os.path.join(folder, "__init__.py")):
        folder, package = os.path.split(folder)
        file = package + "." + file
    sys.path.insert(0, folder)  # The file may import its neighbours.
    network_class = getattr(importlib.import_module(file), name)
    title, arguments, state = read(torch, contents_folder)
    names = inspect.signature(network_class).parameters
    row = {}
    for argument in names:
        for key in (argument, argument + "_g"):
            if key in arguments:
                row[argument] = arguments[key]
    network = network_class(**row)
    network.load_state_dict(state)
    walks = random_walks(arguments["obs_len"] + arguments["pred_len"], int(seed))
    arrays, layers = forecast(
        torch, network, inputs(walks, arguments, int(seed), network)
    )
    for name in NEEDED:
        if name in arguments:
            row.setdefault(name, arguments[name])
    row.update(model="sgan", file=title + ".npz")
    if "alpha" in arrays:
        row.update(model="neurosym", alpha="random")
    np.savez_compressed(os.path.join(out, row["file"]), **arrays)
    with open(os.path.join(out, "manifest.json"), "w") as manifest:
        json.dump([dict(row, layers=layers)], manifest, indent=1)


def read(torch, contents_folder):
    """The checkpoint's name, its arguments and its state dict, from a folder."""
    with open(os.path.join(contents_folder, "contents.json")) as file:
        contents = json.load(file)
    arguments = contents["arguments"]
    for name in contents["tuples"]:
        arguments[name] = tuple(arguments[name])
    with np.load(
        os.path.join(contents_folder, "state.npz"), allow_pickle=False
    ) as arrays:
        values = [arrays[f"arr_{number}"] for number in range(len(arrays.files))]
    state = {
        name: torch.from_numpy(value) for name, value in zip(contents["names"], values)
    }
    return contents["title"], arguments, state


def random_walks(steps, seed):
    """Scenes [N, steps, 2] in metres of people who walk at random, near enough to pool."""
    rng = np.random.RandomState(seed)
    walks = []
    for people in SIZES:
        moves = rng.normal(0, 0.3, (people, steps, 2))
        if people > 2:
            moves[0] = 0
        walks.append(
            (rng.normal(0, 0.5, (people, 1, 2)) + np.cumsum(moves, 1)).round(4)
        )
    return walks


def inputs(walks, arguments, seed, network=None):
    """Arrays of a case's scenes `walks`, [N, steps, 2] each, and noise for them.

    They are float32, or float64 for a network of doubles.
    """
    kind = np.float32
    if network is not None and "64" in str(next(network.parameters()).dtype):
        kind = np.float64
    ends = np.cumsum([len(walk) for walk in walks])
    positions = np.concatenate(walks)
    rows = len(walks) if arguments["noise_mix_type"] == "global" else len(positions)
    dim = int(np.sum(arguments.get("noise_dim") or 0))
    return {
        "traj": positions.astype(kind),
        "traj_rel": np.diff(positions, axis=1, prepend=positions[:, :1]).astype(kind),
        "scene_start_end": np.stack([np.append(0, ends[:-1]), ends], 1),
        "noise": np.random.RandomState(seed).normal(size=(rows, dim)).astype(kind),
    }


def random_alpha(bounds, steps):
    """Weights [P, steps] of all ordered pairs of each scene, whose row is i * N + j."""
    pairs = int(((bounds[:, 1] - bounds[:, 0]) ** 2).sum())
    return np.random.RandomState(0).uniform(0.1, 1, (pairs, steps)).astype(np.float32)


def alpha_layouts(torch, alpha, bounds):
    """The forms in which the releases take `alpha [P, T]`, each as a tuple of arguments.

    The robot package takes a list of [N * N, 1, T], one a scene; the first release all
    rows as [P, T, 1].
    """
    pairs = ((bounds[:, 1] - bounds[:, 0]) ** 2).tolist()
    by_scene = [rows[:, None] for rows in torch.split(alpha, pairs)]
    return [(by_scene,), (alpha[..., None],)]


def forecast(torch, network, scenes):
    """The arrays of a case, and by its name the class of each submodule, in the order of calls.

    `scenes` are arrays as `inputs` makes them. A copy of the network runs, after
    `eval()`. NeuroSyM's, whose `forward` takes weights of pairs, gets random ones.
    """
    network = copy.deepcopy(network).cpu().eval()
    arrays = {
        "g_state/" + name: value.numpy() for name, value in network.state_dict().items()
    }
    arrays.update(scenes)
    classes = {}
    dtype = next(network.parameters()).dtype

    def keep(name, module, inputs, result):
        if not name or name in classes:
            return
        classes[name] = type(module).__name__
        recurrent = isinstance(module, torch.nn.LSTM)
        parts = dict(
            zip(["in"], inputs), out=result[0] if isinstance(result, tuple) else result
        )
        if recurrent and len(inputs) > 1:
            parts["h0"], parts["c0"] = inputs[1]
        for part, array in parts.items():
            if isinstance(array, torch.Tensor):
                rows = array if recurrent else array.reshape(-1, array.shape[-1])
                arrays[part + "/" + name] = rows.numpy()

    for name, module in network.named_modules():
        module.register_forward_hook(functools.partial(keep, name))
    observed = []
    for name in ("traj", "traj_rel"):
        steps = torch.tensor(scenes[name][:, : network.obs_len], dtype=dtype)
        observed.append(steps.transpose(0, 1).contiguous())
    positions = observed[0]
    bounds = torch.tensor(scenes["scene_start_end"])
    noise = torch.tensor(scenes["noise"]).to(dtype)
    layouts = [()]
    if any("weight" in name for name in inspect.signature(network.forward).parameters):
        arrays["alpha"] = random_alpha(scenes["scene_start_end"], network.obs_len)
        alpha = torch.tensor(arrays["alpha"]).to(dtype)
        layouts = alpha_layouts(torch, alpha, scenes["scene_start_end"])
    run = torch.no_grad()(network)
    # The released code moves its states to a CUDA device.
    with mock.patch.object(torch.Tensor, "cuda", lambda self, *_, **__: self):
        for number, weights in enumerate(layouts):
            try:
                moved = run(*observed, *weights, bounds, user_noise=noise)
                break
            except (AttributeError, IndexError, RuntimeError, TypeError):
                if number == len(layouts) - 1:
                    raise
                classes.clear()
    arrays["pred_rel"] = moved.transpose(0, 1).numpy()
    arrays["pred_abs"] = (positions[-1] + moved.cumsum(dim=0)).transpose(0, 1).numpy()
    return arrays, classes


if __name__ == "__main__":
    main(*sys.argv[1:])
