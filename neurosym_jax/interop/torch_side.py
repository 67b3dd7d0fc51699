"""The user's torch module runs here: its inputs, the outputs of all submodules, its forecast.

`neurosym parity --torch-module` runs this file as a script in an interpreter that has torch, any
Python from 3.7 on, and `interop.compare` imports it. It imports nothing of the package, so that
what it saves is torch's alone. A script's argument is JSON: `module` (FILE.py:CLASS),
`checkpoints`, `out` (a folder that is there) and `seed`.
"""

import copy
import importlib
import inspect
import json
import os
import sys

import numpy as np

__all__ = ["forecast", "main", "random_scenes"]

SIZES = (3, 2, 1, 5)
"""People in each scene: of a scene of more than two the first one stands still."""
MOST_ROWS = 4096
"""Of a layer's inputs and outputs that are kept."""


def main(given):
    """Write `manifest.json` and a case for each checkpoint."""
    torch = importlib.import_module("torch")
    path, name = given["module"].rsplit(":", 1)
    module = _import_file(path)
    rows = []
    for number, checkpoint in enumerate(given["checkpoints"]):
        # Where this torch can, it reads no more than weights.
        safely = "weights_only" in inspect.signature(torch.load).parameters
        options = {"weights_only": True} if safely else {}
        contents = torch.load(checkpoint, map_location="cpu", **options)
        arguments = contents["args"]
        arguments = dict(arguments if isinstance(arguments, dict) else vars(arguments))
        network, row = _build(getattr(module, name), arguments, "_g")
        network.load_state_dict(contents["g_state"])
        judge = None
        if contents.get("d_state") is not None and hasattr(module, "TrajectoryDiscriminator"):
            judge, more = _build(module.TrajectoryDiscriminator, arguments, "_d")
            judge.load_state_dict(contents["d_state"])
            row = dict(more, **row)
            row["encoder_h_dim_d"] = row.pop("h_dim")
        scenes = random_scenes(arguments, np.random.RandomState(given["seed"] + number))
        arrays, layers = forecast(torch, network, scenes, judge)
        folder, file = os.path.split(os.path.abspath(checkpoint))
        case = f"{os.path.basename(folder)}_{os.path.splitext(file)[0]}.npz"
        if any(other["file"] == case for other in rows):
            case = f"{number}_{case}"
        np.savez_compressed(os.path.join(given["out"], case), **arrays)
        rows.append(dict({"file": case, "model": "sgan"}, **dict(row, layers=layers)))
    with open(os.path.join(given["out"], "manifest.json"), "w") as file:
        json.dump(rows, file, indent=1)
        file.write("\n")


def random_scenes(arguments, rng):
    """Arrays of a case's scenes, of people who walk at random, and noise for them."""
    steps = arguments["obs_len"] + arguments["pred_len"]
    ends = np.cumsum(SIZES)
    bounds = np.stack([ends - SIZES, ends], 1)
    walks = rng.normal(0, 4, (ends[-1], 1, 2))
    walks = walks + np.cumsum(rng.normal(0, 0.3, (ends[-1], steps, 2)), 1)
    for start, end in bounds:
        if end - start > 2:
            walks[start] = walks[start, :1]
    walks = walks.round(4)
    rows = len(bounds) if arguments["noise_mix_type"] == "global" else len(walks)
    dim = arguments.get("noise_dim") or 0
    noise = rng.normal(size=(rows, int(np.sum(dim)))).astype(np.float32)
    return {
        "traj": walks,
        "traj_rel": np.diff(walks, axis=1, prepend=walks[:, :1]),
        "scene_start_end": bounds,
        "noise": noise,
    }


def forecast(torch, network, scenes, judge=None):
    """The arrays of a case, and by its name the class of each submodule, in the order of calls.

    `scenes` are arrays as `random_scenes` makes them, of which the network sees as many steps as
    its `obs_len`; `judge` is a discriminator. Both are copied, and run on the CPU after `eval()`.
    """
    network = copy.deepcopy(network).cpu().eval()
    dtype = next(network.parameters()).dtype
    seen, steps = network.obs_len, network.obs_len + network.pred_len
    arrays = dict(scenes, traj=scenes["traj"][:, :steps].astype(np.float32))
    arrays["traj_rel"] = scenes["traj_rel"][:, :steps].astype(np.float32)

    def time_first(array):
        return torch.tensor(array[:, :seen], dtype=dtype).transpose(0, 1).contiguous()

    positions, moves = (time_first(scenes[name]) for name in ("traj", "traj_rel"))
    bounds = torch.tensor(scenes["scene_start_end"])
    noise = torch.tensor(scenes["noise"], dtype=dtype)
    parameters = inspect.signature(network.forward).parameters
    required = [name for name, p in parameters.items() if p.default is p.empty][3:]
    if set(required) - {"user_noise"}:
        raise ValueError(f"forward needs {', '.join(required)}, which SGAN's has not")
    if "user_noise" not in parameters and noise.shape[1]:
        raise ValueError("forward takes no user_noise, so its noise cannot be given")
    options = {"user_noise": noise} if "user_noise" in parameters else {}
    calls = {}
    cuda = torch.Tensor.cuda

    def keep(name):
        def hook(module, given, result):
            calls.setdefault(name, []).append((module, given, result))

        return hook

    for name, module in network.named_modules():
        if name:
            module.register_forward_hook(keep(name))
    # The released code moves its states to a CUDA device.
    torch.Tensor.cuda = lambda self, *_, **__: self
    try:
        with torch.no_grad():
            moved = network(positions, moves, bounds, **options)
            after = positions[-1] + moved.cumsum(dim=0)
            arrays["pred_rel"] = moved.transpose(0, 1).numpy()
            arrays["pred_abs"] = after.transpose(0, 1).numpy()
            if judge is not None:
                judge = copy.deepcopy(judge).cpu().eval()
                whole = torch.cat([positions, after]), torch.cat([moves, moved])
                arrays["d_scores_fake"] = judge(*whole, bounds).flatten().numpy()
                arrays.update(_weights("d_state/", judge))
    finally:
        torch.Tensor.cuda = cuda
    arrays.update(_weights("g_state/", network))
    for name, made in calls.items():
        for part, array in _kept(torch, made).items():
            arrays[f"{part}/{name}"] = array.numpy()
    return arrays, {name: type(made[0][0]).__name__ for name, made in calls.items()}


def _kept(torch, made):
    """Inputs and outputs of a submodule: all calls as rows, of one with submodules the first."""
    module, given, result = made[0]
    first = result[0] if isinstance(result, tuple) else result
    if not isinstance(module, torch.nn.Sequential) and list(module.children()):
        return {"out": first.reshape(-1, first.shape[-1])}
    if isinstance(result, tuple):  # An LSTM: [T, A, E], and its states.
        same = [call for call in made if call[1][0].shape[0] == given[0].shape[0]]
        parts = {"in": [call[1][0] for call in same], "out": [call[2][0] for call in same]}
        if len(given) > 1:
            parts["h0"] = [call[1][1][0] for call in same]
            parts["c0"] = [call[1][1][1] for call in same]
        return {name: torch.cat(tensors, 1)[:, :MOST_ROWS] for name, tensors in parts.items()}
    parts = {"in": [call[1][0] for call in made], "out": [call[2] for call in made]}
    return {
        name: torch.cat([t.reshape(-1, t.shape[-1]) for t in tensors])[:MOST_ROWS]
        for name, tensors in parts.items()
    }


def _build(network, arguments, suffix):
    """The network of these arguments of a training, and the manifest's fields of them."""
    parameters = inspect.signature(network.__init__).parameters
    given = {}
    for name in list(parameters)[1:]:
        for known in (name, name + suffix, "encoder_" + name + suffix):
            if known in arguments:
                given[name] = arguments[known]
                break
    return network(**given), given


def _import_file(path):
    """The module of a file, which may import its neighbours."""
    folder, file = os.path.split(os.path.abspath(path))
    name = os.path.splitext(file)[0]
    while os.path.isfile(os.path.join(folder, "__init__.py")):
        folder, package = os.path.split(folder)
        name = package + "." + name
    sys.path.insert(0, folder)
    return importlib.import_module(name)


def _weights(prefix, network):
    return {prefix + name: value.numpy() for name, value in network.state_dict().items()}


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
