"""SGAN's arguments and weights as configurations of ours.

Widths are read from the shapes of the weights, everything else from the arguments. An argument that
our networks do not have is refused by name and value, one that nobody knows by name.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS

__all__ = [
    "TORCH_POOLING",
    "assumptions",
    "discriminator_config",
    "generator_config",
    "refuse_unknown",
]

TORCH_POOLING = {"none": "none", "pool_net": "pool_net", "social": "spool"}
"""SGAN's names of the poolings; NeuroSyM's code calls its own `pool_net` as well."""
GIVEN = (
    *("obs_len", "pred_len", "noise_dim", "noise_type", "noise_mix_type", "pooling_type"),
    "pool_every_timestep",
)
"""What weights cannot say, or must not contradict."""
WIDTHS = {
    "embedding_dim": (("encoder.spatial_embedding.weight", 0),),
    "encoder_h_dim": (("encoder.encoder.weight_hh_l0", 1),),
    "decoder_h_dim": (("decoder.decoder.weight_hh_l0", 1),),
    "mlp_dim": (("mlp_decoder_context.0.weight", 0), ("decoder.mlp.0.weight", 0)),
}
"""Our fields, and the first of these weights that is there with the axis that has the width."""
FIXED = {"num_layers": 1, "activation": "relu"}
"""Arguments of SGAN's networks that ours have in one form only."""
NETWORK = {
    *("batch_norm", "dropout", "embedding_dim", "mlp_dim", "bottleneck_dim"),
    *("neighborhood_size", "grid_size", "d_type", "encoder_h_dim_d", "h_dim", "weighting"),
    *("encoder_h_dim", "decoder_h_dim", "encoder_h_dim_g", "decoder_h_dim_g"),
    *GIVEN,
    *FIXED,
}
TRAINING = {
    *("dataset_name", "delim", "loader_num_workers", "skip", "batch_size", "num_iterations"),
    *("num_epochs", "clipping_threshold_g", "clipping_threshold_d", "g_learning_rate"),
    *("d_learning_rate", "g_steps", "d_steps", "l2_loss_weight", "best_k", "output_dir"),
    *("print_every", "checkpoint_every", "checkpoint_name", "checkpoint_start_from"),
    *("restore_from_checkpoint", "num_samples_check", "use_gpu", "timing", "gpu_num"),
    *("labels_dir", "filename"),
}
"""Arguments of the released training scripts that change no network."""


def refuse_unknown(arguments: Iterable[Any], ignored: Iterable[str], more: Iterable[str]) -> None:
    """Refuse arguments that neither the released code, `ignored` nor `more` names.

    Raises:
        InputError: naming the first, and one in `ignored` that is not there.
    """
    arguments = set(arguments)
    if absent := set(ignored) - arguments:
        raise InputError(f"--ignore-arg {min(absent)}: there is no such argument")
    if unknown := arguments - NETWORK - TRAINING - {*ignored, *more}:
        name = min(map(str, unknown))
        raise InputError(
            f"unknown argument {name!r}, which may change the network: "
            f"if it does not, let it pass with --ignore-arg {name}"
        )


def generator_config(
    arguments: Mapping[str, Any],
    state: Mapping[str, Any],
    source: str,
    *,
    variant: str | None = None,
) -> GeneratorConfig:
    """The generator of these arguments and weights.

    Args:
        arguments: of SGAN's training or of its generator.
        state: tensors by torch's names, numbered as `names.plain_state` does.
        source: for messages.
        variant: NeuroSyM's pooling, if it is known; else it is inferred from `state`.

    Raises:
        InputError: naming `source` and an argument that is missing or that our networks lack.
    """
    own = {name: _argument(arguments, name, source) for name in GIVEN}
    _refuse_other_forms(arguments, source)
    for name, places in WIDTHS.items():
        width = next((w for w in (_width(state, *place) for place in places) if w), None)
        if width is None:
            width = arguments.get(name, arguments.get(f"{name}_g"))
        own |= {} if width is None else {name: width}
    own["noise_dim"] = _noise_dim(own, _width(state, "mlp_decoder_context.2.weight", 0), source)
    own["pool_every_timestep"] = bool(own["pool_every_timestep"])
    torch_pooling = str(own.pop("pooling_type") or "none").lower()
    named = {theirs: ours for ours, theirs in TORCH_POOLING.items()}
    history = _shape(state, "pool_net_g.spatial_embedding.weight")
    if history and variant is None and torch_pooling == "pool_net":
        variant = "neurosym_ijcnn" if history[1:] == (2,) else "neurosym_ros"
        if variant == "neurosym_ros":
            own["weighting"] = arguments.get("weighting", "cnd_shipped")
    if variant is not None:
        named = {"pool_net": variant}
    if torch_pooling not in named:
        known = ", ".join(map(repr, named))
        raise InputError(f"{source}: pooling_type is one of {known}, not {torch_pooling!r}")
    own["pooling"] = _pooling(named[torch_pooling], arguments, state, source)
    return from_json(GeneratorConfig, own, source)


def discriminator_config(
    arguments: Mapping[str, Any], state: Mapping[str, Any], source: str
) -> DiscriminatorConfig:
    """The discriminator of these arguments and weights.

    Raises:
        InputError: as `generator_config`.
    """
    _refuse_other_forms(arguments, source)
    fields = {
        "embedding_dim": _width(state, "encoder.spatial_embedding.weight", 0),
        "h_dim": _width(state, "encoder.encoder.weight_hh_l0", 1),
        "mlp_dim": _width(state, "real_classifier.0.weight", 0),
        "pool_hidden_dim": _width(state, "pool_net.mlp_pre_pool.0.weight", 0),
    }
    known = {name: width for name, width in fields.items() if width}
    kind = _argument(arguments, "d_type", source)
    return from_json(DiscriminatorConfig, known | {"kind": kind}, source)


def assumptions(arguments: Mapping[str, Any], config: GeneratorConfig) -> tuple[str, ...]:
    """What arguments and weights do not say, in words, and where the weights overrule them."""
    found = ["forward as in the released code"]
    if "activation" not in arguments:
        found += ["activation relu"]
    if arguments.get("batch_norm"):
        found += ["batch norm by its running statistics, as after eval()"]
    if config.weighting is not None and "weighting" not in arguments:
        found += [f"pairs weighted by {config.weighting.name}"]
    actual = {name: getattr(config, name) for name in WIDTHS} | vars(config.pooling)
    for name, value in actual.items():
        said = arguments.get(name, arguments.get(f"{name}_g", value))
        if said != value and (name != "mlp_dim" or config.needs_context_mlp):
            found += [f"{name} {value} by its weights, not {said}"]
    return tuple(found)


def _pooling(
    kind: str, arguments: Mapping[str, Any], state: Mapping[str, Any], source: str
) -> dict[str, Any]:
    """A pooling's options as JSON has them, by its weights, else its arguments."""
    prefix = "pool_net_g" if kind.startswith("neurosym") else "pool_net"
    options = {
        "bottleneck_dim": _width(state, f"{prefix}.mlp_pre_pool.2.weight", 0),
        "hidden_dim": _width(state, f"{prefix}.mlp_pre_pool.0.weight", 0),
    }
    if kind == "social":
        options = {n: _argument(arguments, n, source) for n in ("neighborhood_size", "grid_size")}
        hidden = _width(state, "pool_net.mlp_pool.0.weight", 0)
        taken = _width(state, "mlp_decoder_context.0.weight", 1)
        if hidden and taken and taken != 2 * hidden:
            raise InputError(
                f"{source}: social pooling returns a hidden state: bottleneck_dim must equal "
                f"encoder_h_dim ({hidden}), not {taken - hidden}"
            )
    fields = {field.name for field in dataclasses.fields(POOLINGS[kind])}
    return {"kind": kind} | {k: v for k, v in options.items() if k in fields and v is not None}


def _refuse_other_forms(arguments: Mapping[str, Any], source: str) -> None:
    for name, value in FIXED.items():
        if arguments.get(name, value) != value:
            given = arguments[name]
            raise InputError(f"{source}: {name} is {given!r}, and our networks have {value!r} only")


def _noise_dim(own: Mapping[str, Any], context: int | None, source: str) -> Any:
    """Size of the noise, which fills what the vector before it, of size `context`, leaves."""
    noise, hidden = own["noise_dim"], own.get("decoder_h_dim")
    if isinstance(noise, tuple | list):
        if len(noise) > 1:
            raise InputError(f"{source}: noise_dim is {noise!r}, and ours is one number")
        noise = noise[0] if noise else 0
    noise = noise or 0
    if context and isinstance(hidden, int) and noise != hidden - context:
        room = hidden - context
        raise InputError(f"{source}: noise_dim is {noise!r}, and the weights have room for {room}")
    return noise


def _argument(arguments: Mapping[str, Any], name: str, source: str) -> Any:
    if name not in arguments:
        raise InputError(f"{source}: {name} is missing or not a plain value")
    return arguments[name]


def _shape(state: Mapping[str, Any], name: str) -> tuple[int, ...] | None:
    shape = getattr(state.get(name), "shape", None)
    return shape if isinstance(shape, tuple) and len(shape) == 2 else None


def _width(state: Mapping[str, Any], name: str, axis: int) -> int | None:
    shape = _shape(state, name)
    return None if shape is None else shape[axis]
