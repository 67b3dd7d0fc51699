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
    "TRAINING",
    "Training",
    "alpha_arguments",
    "discriminator",
    "forecast",
    "inputs",
    "main",
    "random_alpha",
    "random_walks",
    "read",
    "takes_alpha",
    "trainings",
]

NEEDED = (
    *("noise_type", "noise_mix_type", "noise_dim", "dropout"),
    *("pooling_type", "pool_every_timestep", "neighborhood_size", "grid_size"),
)
"""Arguments that the description of a case has, whether the constructor takes them or not."""
TRAINING = "training.npz"
"""The file of a training's inputs, and of its results."""
ADAM = "adam/"
"""Prefix of the states of optimisers among the inputs: `adam/g/NUMBER/NAME` and `adam/d/...`."""
FRESH_BIAS = 3.0
"""Added to a fresh discriminator's last bias: it lives for a hundred steps."""
SIZES = (3, 2, 1, 5)
"""People in each scene: of a scene of more than two the first one stands still."""


def main(path, contents_folder, out, name, seed):
    """Write the case of a checkpoint in the class `name` of the file `path`, and its manifest.

    `contents_folder` holds what our reader read of the checkpoint (see
    `parity.hand_over`). The file itself is not opened here: a second parser might read
    another program in it than the one that was checked. A training is run where the
    folder holds one.
    """
    torch = importlib.import_module("torch")
    stem, _ = os.path.splitext(os.path.abspath(path))
    folder, file = os.path.split(stem)
    while os.path.isfile(os.path.join(folder, "__init__.py")):
        folder, package = os.path.split(folder)
        file = package + "." + file
    sys.path.insert(0, folder)  # The file may import its neighbours.
    module = importlib.import_module(file)
    network_class = getattr(module, name)
    title, arguments, states, settings = read(torch, contents_folder)
    names = inspect.signature(network_class).parameters
    row = {}
    for argument in names:
        for key in (argument, argument + "_g"):
            if key in arguments:
                row[argument] = arguments[key]
    network = network_class(**row)
    network.load_state_dict(states["g_state"])
    if settings is not None:
        critic = discriminator(torch, module, arguments, states, int(seed))
        with np.load(os.path.join(contents_folder, TRAINING)) as inputs_:
            arrays = trainings(torch, network, critic, dict(inputs_), settings)
        np.savez(os.path.join(out, TRAINING), **arrays)
        return
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
    """From a folder: the checkpoint's name, arguments and state dicts by name, and the
    settings of a training, or None."""
    with open(os.path.join(contents_folder, "contents.json")) as file:
        contents = json.load(file)
    arguments = contents["arguments"]
    for name in contents["tuples"]:
        arguments[name] = tuple(arguments[name])
    states = {}
    path = os.path.join(contents_folder, "state.npz")
    with np.load(path, allow_pickle=False) as arrays:
        for key in arrays.files:
            state, _, name = key.partition("/")
            states.setdefault(state, {})[name] = torch.from_numpy(arrays[key])
    return contents["title"], arguments, states, contents.get("training")


def random_walks(steps, seed):
    """Scenes [N, steps, 2] in metres of people who walk at random, near enough to pool."""
    rng = np.random.RandomState(seed)
    walks = []
    for people in SIZES:
        moves = rng.normal(0, 0.3, (people, steps, 2))
        if people > 2:
            moves[0] = 0
        start = rng.normal(0, 0.5, (people, 1, 2))
        walk = start + np.cumsum(moves, axis=1)
        walks.append(walk.round(4))
    return walks


def inputs(walks, arguments, seed, network):
    """Arrays of a case's scenes `walks`, [N, steps, 2] each, and noise for them.

    They are float32, or float64 for a network of doubles.
    """
    is_double = "64" in str(next(network.parameters()).dtype)
    kind = np.float64 if is_double else np.float32
    ends = np.cumsum([len(walk) for walk in walks])
    starts = np.append(0, ends[:-1])
    positions = np.concatenate(walks)
    moves = np.diff(positions, axis=1, prepend=positions[:, :1])
    rows = len(walks) if arguments["noise_mix_type"] == "global" else len(positions)
    dim = int(np.sum(arguments.get("noise_dim") or 0))
    rng = np.random.RandomState(seed)
    noise = rng.normal(size=(rows, dim))
    return {
        "traj": positions.astype(kind),
        "traj_rel": moves.astype(kind),
        "scene_start_end": np.stack([starts, ends], axis=1),
        "noise": noise.astype(kind),
    }


def random_alpha(bounds, steps):
    """Weights [P, steps] of all ordered pairs of each scene, whose row is i * N + j."""
    sizes = bounds[:, 1] - bounds[:, 0]
    pairs = int((sizes**2).sum())
    rng = np.random.RandomState(0)
    alpha = rng.uniform(0.1, 1, (pairs, steps))
    return alpha.astype(np.float32)


def takes_alpha(network):
    """Whether the network's `forward` takes weights of pairs, as NeuroSyM's do."""
    names = inspect.signature(network.forward).parameters
    return any("weight" in name for name in names)


def alpha_arguments(torch, network, alpha, bounds):
    """The arguments that are weights `alpha [P, T]` of pairs, for the `network`'s release.

    SGAN takes none. The first release, which embeds single steps, takes [T, P, 1]; the
    robot package a list of [N * N, 1, T], one a scene.
    """
    if not takes_alpha(network):
        return ()
    pooling = getattr(network, "pool_net_g", None)
    if pooling is None or pooling.spatial_embedding.in_features == 2:
        return (alpha.T[..., None],)
    pairs = (bounds[:, 1] - bounds[:, 0]) ** 2
    by_scene = torch.split(alpha, pairs.tolist())
    return ([rows[:, None] for rows in by_scene],)


def forecast(torch, network, scenes):
    """The arrays of a case, and by its name the class of each submodule, in the order of calls.

    `scenes` are arrays as `inputs` makes them. A copy of the network runs, after
    `eval()`. NeuroSyM's, whose `forward` takes weights of pairs, gets random ones.
    """
    network = copy.deepcopy(network).cpu().eval()
    arrays = {}
    for name, value in network.state_dict().items():
        arrays["g_state/" + name] = value.numpy()
    arrays.update(scenes)
    classes = {}
    dtype = next(network.parameters()).dtype

    def keep(name, module, inputs, result):
        if not name or name in classes:
            return
        classes[name] = type(module).__name__
        recurrent = isinstance(module, torch.nn.LSTM)
        parts = {"out": result[0] if isinstance(result, tuple) else result}
        if inputs:
            parts["in"] = inputs[0]
        if recurrent and len(inputs) > 1:
            parts["h0"], parts["c0"] = inputs[1]
        for part, array in parts.items():
            if isinstance(array, torch.Tensor):
                if not recurrent:
                    array = array.reshape(-1, array.shape[-1])
                arrays[part + "/" + name] = array.numpy()

    for name, module in network.named_modules():
        module.register_forward_hook(functools.partial(keep, name))
    observed = []
    for name in ("traj", "traj_rel"):
        steps = torch.tensor(scenes[name][:, : network.obs_len], dtype=dtype)
        observed.append(steps.transpose(0, 1).contiguous())
    positions = observed[0]
    bounds = torch.tensor(scenes["scene_start_end"])
    noise = torch.tensor(scenes["noise"]).to(dtype)
    weights = ()
    if takes_alpha(network):
        arrays["alpha"] = random_alpha(scenes["scene_start_end"], network.obs_len)
        alpha = torch.tensor(arrays["alpha"]).to(dtype)
        weights = alpha_arguments(torch, network, alpha, bounds)
    # The released code moves its states to a CUDA device.
    with mock.patch.object(torch.Tensor, "cuda", lambda self, *_, **__: self):
        run = torch.no_grad()(network)
        moved = run(*observed, *weights, bounds, user_noise=noise)
    places = positions[-1] + moved.cumsum(dim=0)
    arrays["pred_rel"] = moved.transpose(0, 1).numpy()
    arrays["pred_abs"] = places.transpose(0, 1).numpy()
    return arrays, classes


def discriminator(torch, module, arguments, states, seed):
    """SGAN's discriminator of the file: with the checkpoint's weights, or with fresh ones.

    Its last layer ends in a ReLU: fresh weights with a bias of 0 may score everything
    0, and then nothing learns.
    """
    network_class = module.TrajectoryDiscriminator
    sizes = dict(arguments, h_dim=arguments.get("encoder_h_dim_d", 48))
    names = inspect.signature(network_class).parameters
    torch.manual_seed(seed)
    known = {name: sizes[name] for name in names if name in sizes}
    network = network_class(**known)
    if "d_state" in states:
        network.load_state_dict(states["d_state"])
    else:
        with torch.no_grad():
            network.real_classifier[-2].bias += FRESH_BIAS
    return network


def trainings(torch, network, critic, inputs_, settings):
    """Weights after the reported steps and losses, by names, in float64 and in float32."""
    arrays = {}
    torch.set_num_threads(1)  # Operations this small gain nothing from more.
    with mock.patch.object(torch.Tensor, "cuda", lambda self, *_, **__: self):
        for dtype in (torch.float64, torch.float32):
            # The released code makes zeros of the default type.
            torch.set_default_dtype(dtype)
            training = Training(
                torch,
                copy.deepcopy(network).cpu().to(dtype).eval(),
                copy.deepcopy(critic).cpu().to(dtype).eval(),
                settings,
            )
            tensors = {name: torch.tensor(values) for name, values in inputs_.items()}
            type_name = str(dtype).split(".")[-1]
            for key, value in training.run(tensors).items():
                arrays[type_name + "/" + key] = value
    return arrays


class Training:
    """SGAN's and NeuroSyM's own steps, with batches, noises and labels that are given.

    They are those of `scripts/train.py` and `scripts/train_informed.py`.
    """

    def __init__(self, torch, network, critic, settings):
        self.torch = torch
        self.network = network
        self.critic = critic
        self.settings = settings
        self.adam = torch.optim.Adam(network.parameters(), lr=settings["learning_rate"])
        self.critic_adam = torch.optim.Adam(
            critic.parameters(), lr=settings["d_learning_rate"]
        )

    def run(self, inputs_):
        """The arrays of `settings["reported"]` steps, from the optimisers' states on."""
        for network, adam in (("g", self.adam), ("d", self.critic_adam)):
            state = adam.state_dict()
            for key in inputs_:
                if key.startswith(ADAM + network):
                    number, name = key.split("/")[2:]
                    state["state"].setdefault(int(number), {})[name] = inputs_[key]
            adam.load_state_dict(state)
        self.bounds = inputs_["bounds"]
        dtype = self.torch.get_default_dtype()
        inputs_ = {name: values.to(dtype) for name, values in inputs_.items()}

        arrays = {}
        losses = []
        for name, state in self.states().items():
            arrays["0/" + name] = state
        for step, (real, fake, generator_label) in enumerate(inputs_["labels"]):
            traj, alpha = inputs_["traj"][step], inputs_["alpha"][step]
            first, second = zip(traj, inputs_["traj_rel"][step], alpha)
            noise, noises = inputs_["noise_d"][step], inputs_["noise_g"][step]
            losses.append(self.step_critic(*first, noise, real, fake))
            self.step_network(*second, noises, generator_label)
            if step + 1 in self.settings["reported"]:
                for name, state in self.states().items():
                    arrays[str(step + 1) + "/" + name] = state
        arrays["d_loss"] = np.array(losses)
        return arrays

    def states(self):
        """Copies of all weights, by `g_state/NAME` and `d_state/NAME`."""
        states = {}
        for prefix, network in (("g_state/", self.network), ("d_state/", self.critic)):
            for name, value in network.state_dict().items():
                states[prefix + name] = value.numpy().copy()
        return states

    def forecast(self, traj, traj_rel, alpha, noise):
        """Displacements and positions [T, A, 2], first those observed, then the forecast."""
        observed = self.network.obs_len
        seen = traj[:observed].contiguous()
        moved = traj_rel[:observed].contiguous()
        weights = alpha_arguments(
            self.torch, self.network, alpha[:, :observed], self.bounds
        )
        moves = self.network(seen, moved, *weights, self.bounds, user_noise=noise)
        places = seen[-1] + moves.cumsum(dim=0)
        return self.torch.cat([moved, moves]), self.torch.cat([seen, places])

    def scores(self, traj, traj_rel, alpha):
        """The discriminator's scores [A, 1]."""
        weights = alpha_arguments(self.torch, self.critic, alpha, self.bounds)
        return self.critic(traj, traj_rel, *weights, self.bounds)

    def cross_entropy(self, scores, label):
        """SGAN's `bce_loss` with one label for all scores."""
        decay = (-scores.abs()).exp()
        losses = scores.clamp(min=0) - scores * label + (1 + decay).log()
        return losses.mean()

    def step_critic(self, traj, traj_rel, alpha, noise, label_real, label_fake):
        """SGAN's `discriminator_step`; the loss before it."""
        moves, places = self.forecast(traj, traj_rel, alpha, noise)
        real = self.scores(traj, traj_rel, alpha)
        fake = self.scores(places, moves, alpha)
        loss = self.cross_entropy(real, label_real)
        loss = loss + self.cross_entropy(fake, label_fake)
        self.critic_adam.zero_grad()
        loss.backward()
        self.critic_adam.step()
        return loss.item()

    def step_network(self, traj, traj_rel, alpha, noises, label):
        """SGAN's `generator_step`."""
        observed = self.network.obs_len
        future = traj_rel[observed:]
        errors = []
        for noise in noises:
            moves, places = self.forecast(traj, traj_rel, alpha, noise)
            squared = (moves[observed:] - future) ** 2
            error = squared.sum(dim=(0, 2))
            errors.append(self.settings["variety_weight"] * error)
        errors = self.torch.stack(errors, dim=1)
        loss = 0.0
        for start, end in self.bounds.tolist():
            best = errors[start:end].sum(dim=0).min()
            loss = loss + best / ((end - start) * len(future))
        scores = self.scores(places, moves, alpha)
        loss = loss + self.cross_entropy(scores, label)
        self.adam.zero_grad()
        loss.backward()
        if self.settings["clip_norm"]:
            self.torch.nn.utils.clip_grad_norm_(
                self.network.parameters(), self.settings["clip_norm"]
            )
        self.adam.step()


if __name__ == "__main__":
    main(*sys.argv[1:])
