"""Weightings of pairs: the base class, those that ship, and the table that plugins extend."""

import abc
import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import (
    Checked,
    NotNegative,
    Positive,
    Whole,
    component,
    differences,
    refuse,
)
from neurosym_jax.errors import InputError, brief
from neurosym_jax.plugins import Registry
from neurosym_jax.symbolic.qtc import (
    Convention,
    alpha_table,
    encode_state,
    observe,
    other_pairs,
)
from neurosym_jax.symbolic.soft import soft_alpha, soft_symbols

__all__ = [
    "WEIGHTINGS",
    "Cnd",
    "CndShipped",
    "Learned",
    "Ones",
    "Parameters",
    "Quantised",
    "Shuffled",
    "Soft",
    "Weighting",
    "Zeros",
    "checked_mask",
    "initial_parameters",
    "is_constant",
    "make_weighting",
    "register_weighting",
]


# Weightings: how much agent j matters to agent i at each step, alpha [N, N, T].
#
# NeuroSyM (Mghames et al., 2023) multiplies the features of a pair by alpha, looked up by
# the QTC_C1 state that the pair was last observed in. A weighting is a frozen dataclass:
# its fields are its options, and equal weightings share compiled programs. What it learns
# is in the model's parameters, `params["weighting"]`. The built-in ones are in
# `weightings`.

Parameters = Mapping[str, Any]
"""Arrays that a weighting learns, by name."""


@dataclasses.dataclass(frozen=True)
class Weighting(Checked, abc.ABC):
    """A weighting; a subclass has its options as fields and overrides `weigh`."""

    title: ClassVar[str] = ""
    """The name by which it is registered, in text forms and tables."""

    @abc.abstractmethod
    def weigh(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """[N, N, T] weights of all ordered pairs of one scene, see `alpha` for the arguments.

        Positions that are not there are zeros here; `alpha` takes the weights of their
        pairs away.
        """

    def start(self) -> Parameters:
        """Parameters before training."""
        return {}

    def accepted(self) -> Parameters:
        """Parameters that `alpha` takes, with values of their shapes; by default `start()`."""
        return self.start()

    def refuse_parameters(self, parameters: Parameters) -> None:
        """Refuse parameters of other names or shapes than the weighting has.

        Raises:
            InputError: naming the first, and those that there are.
        """
        accepted = self.accepted()
        for name, value in parameters.items():
            if name not in accepted:
                names = ", ".join(accepted) or "none"
                raise InputError(
                    f"{self.name} has no parameter {brief(name)}; it has {names}"
                )
            shape = list(jnp.shape(value))
            expected = list(np.shape(accepted[name]))
            if shape != expected:
                raise InputError(
                    f"the parameter {name} of {self.name} is {shape}, not {expected}"
                )
        for name in self.start():
            if name not in parameters:
                raise InputError(
                    f"{self.name} needs the parameter {name!r}; "
                    "initial_parameters(weighting) has all, before training"
                )

    def thresholds(self, parameters: Parameters, period: float) -> dict[str, Any]:
        """Arguments of `qtc.observe` at steps of `period` seconds."""
        return {}

    def codes(
        self, parameters: Parameters, positions: ArrayLike, *, period: float = 0.4
    ) -> Array:
        """[N, N, T-1] codes of the QTC_C1 states of all ordered pairs of `positions [N, T, 2]`."""
        positions = jnp.asarray(positions)
        thresholds = self.thresholds(parameters, period)
        return encode_state(observe(positions[:, None], positions, **thresholds))

    def alpha(
        self,
        parameters: Parameters,
        positions: ArrayLike,
        valid: ArrayLike | None = None,
        *,
        period: float = 0.4,
    ) -> Array:
        """Weights of the interactions of every ordered pair of one scene.

        The state observed from t-1 to t weights the interaction at t, so t = 0 has no
        state and weighs 0 unless a weighting defines it. An agent weighs 1 for itself;
        pairs with padding weigh 0, and so does a single valid agent, whatever the
        padded size. Where a position is not there (NaN), now or at the step before, the
        pair has no state and weighs 0; gradients through it are 0.

        Args:
            parameters: as `start()`, or trained.
            positions: [N, T, 2] metres, T >= 1.
            valid: [N] bool, False for padding; None for no padding.
            period: seconds between steps, by which thresholds in m/s become metres.

        Returns:
            [N, N, T]; (i, j) is how much j matters to i.

        Raises:
            InputError: for other shapes, a mask that is not bool, and parameters of
                other names than `start()` has; all are known when the function is
                traced.
        """
        positions = jnp.asarray(positions, jnp.result_type(positions, 0.0))
        if positions.ndim != 3 or positions.shape[2] != 2:
            raise InputError(f"positions are {list(positions.shape)}, not [N, T, 2]")
        self.refuse_parameters(parameters)
        agents = positions.shape[0]
        present = checked_mask(valid, agents)
        missing = jnp.isnan(positions).any(axis=-1)
        filled = jnp.where(missing[..., None], 0, positions)
        alpha = jnp.asarray(self.weigh(parameters, filled, present, period))
        shape = (agents, agents, positions.shape[1])
        if alpha.shape != shape:
            raise InputError(
                f"weighting {self.title}: returns {list(alpha.shape)}, not {list(shape)}"
            )
        alpha = alpha.astype(positions.dtype)
        itself = jnp.eye(agents, dtype=bool)[..., None]
        alpha = jnp.where(itself, 1, alpha)
        # A step needs the position before it, too.
        missing |= jnp.pad(missing[:, :-1], [(0, 0), (1, 0)])
        steps = present[:, None] & ~missing
        pairs = steps[:, None] & steps[None] & (present.sum() != 1)
        return jnp.where(pairs, alpha, 0)

    @property
    def name(self) -> str:
        """Its title and the options that differ from their defaults: `soft,temperature=0.1`."""
        return ",".join([self.title, *differences(self)])


def checked_mask(valid: ArrayLike | None, agents: Any) -> Array:
    """`valid` [N] as an array; None is no padding.

    Raises:
        InputError: for another shape or type, which is known when it is traced.
    """
    if valid is None:
        return jnp.ones(agents, bool)
    mask = jnp.asarray(valid)
    if mask.shape != (agents,):
        raise InputError(f"valid is {list(mask.shape)}, not [{agents}]")
    # `~` of numbers is another number, which counts as true.
    if mask.dtype != bool:
        raise InputError(f"valid must be bool [{agents}], not {mask.dtype}")
    return mask


def initial_parameters(weighting: Weighting | None) -> dict[str, np.ndarray]:
    """Parameters of the weighting before training, float32; empty for None."""
    start = {} if weighting is None else weighting.start()
    return {name: np.asarray(value, np.float32) for name, value in start.items()}


def is_constant(alpha: np.ndarray) -> bool:
    """Whether `alpha [N, N, T]` is the same for all pairs at all steps but the first."""
    others = alpha[~np.eye(len(alpha), dtype=bool)][:, 1:]
    return others.size > 0 and np.ptp(others) == 0


# The table of weightings and its members, and how a plugin adds one
# (`register_weighting`).
#
# Most look alpha up by the QTC_C1 state of a pair. A table gives each of the 81 states a
# weight: `cnd` the theory's, `cnd_shipped` the authors', `learned` 81 free ones.
# `quantised` has symbols that are 0 below a threshold, `soft` the expectation over
# symbols that fade into each other, and `shuffled`, a control, gives weights to the wrong
# pairs.


@dataclasses.dataclass(frozen=True)
class Cnd(Weighting):
    """The papers' 1 / N_Tr, N_Tr the number of neighbours of the state in the theory's diagram."""

    title = "cnd"
    speed: NotNegative = 0.0
    """Metres per second up to which a movement counts as none: `quantisation_factor` of
    `qtc.observe` in a unit that means the same at every period."""
    side_speed: NotNegative | None = None
    """The same for q3 and q4, see `qtc.observe`."""
    convention: Convention = "distance"
    """Definition of the symbols, see `qtc`."""

    def thresholds(self, parameters: Parameters, period: float) -> dict[str, Any]:
        """See `Weighting.thresholds`; a learned speed replaces the option."""
        side = self.side_speed
        return {
            "quantisation_factor": period * value_of(parameters, self, "speed"),
            "side_quantisation_factor": None if side is None else period * side,
            "convention": self.convention,
        }

    def state_weights(self) -> np.ndarray:
        """[81] weights of the QTC_C1 states by code, before training."""
        return alpha_table("c1")

    def weigh(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """See `Weighting.weigh`; at the first step no state has been observed."""
        observed = self.observed(parameters, positions, valid, period)
        unobserved = parameters.get("unobserved", 0.0)
        first = jnp.full((*observed.shape[:2], 1), unobserved, observed.dtype)
        return jnp.concatenate([first, observed], axis=-1)

    def observed(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """[N, N, T-1] weights of the states observed in positions [N, T, 2] of `valid [N]`."""
        table = jnp.asarray(
            parameters.get("table", self.state_weights()), positions.dtype
        )
        codes = self.codes(parameters, positions, period=period)
        # On an Explicit mesh the sharding of a gather's result, and of its gradient under
        # `vmap`, is ambiguous; that of a product is not.
        if jax.typeof(codes).sharding.mesh.are_all_axes_explicit:
            rows = jax.nn.one_hot(codes.clip(0, len(table) - 1), len(table))
            return rows.astype(table.dtype) @ table
        return table.at[codes].get(mode="clip")


def value_of(parameters: Parameters, weighting: Weighting, option: str) -> Any:
    """An option of `weighting`, or its learned value, of which the logarithm is a parameter."""
    name = f"log_{option}"
    if name in parameters:
        return jnp.exp(parameters[name])
    return getattr(weighting, option)


@dataclasses.dataclass(frozen=True)
class CndShipped(Cnd):
    """The authors' own table, 1 / (2^nonzero 3^zero).

    It counts neighbours by continuity alone, and staying in the state as one of them.
    """

    title = "cnd_shipped"
    decimals: Whole | None = None
    """Decimals to which the table is rounded; the authors printed theirs with 4."""

    def state_weights(self) -> np.ndarray:
        """See `Cnd.state_weights`."""
        table = alpha_table("c1", rule="continuity", include_self=True)
        if self.decimals is None:
            return table
        return np.round(table, self.decimals)


@dataclasses.dataclass(frozen=True)
class Learned(Cnd):
    """81 free weights, one a state, and one for the first step; they start at `cnd` and 0."""

    title = "learned"

    def start(self) -> Parameters:
        """`table` [81] and `unobserved` []."""
        return {"table": self.state_weights(), "unobserved": 0.0}


@dataclasses.dataclass(frozen=True)
class Quantised(Cnd):
    """`cnd` of symbols that are 0 below 0.125 m/s, 5 cm in 0.4 s.

    A learned threshold has straight-through gradients: symbols are hard, their
    gradients those of soft ones.
    """

    title = "quantised"
    speed: NotNegative = 0.125
    temperature: Positive = 0.05
    """Metres per second over which a symbol fades into the next, in gradients of the threshold."""
    learned: bool = False
    """Whether training changes the threshold."""
    fades: ClassVar[bool] = False
    """Whether alpha itself is the expectation over soft symbols."""

    def __post_init__(self):
        """Refuse a threshold that cannot be learned."""
        super().__post_init__()
        if self.learned and not self.speed:
            raise InputError("a speed of 0 cannot be learned: its logarithm is")

    def accepted(self) -> Parameters:
        """Those that it would learn, learned or not: a temperature may be traced."""
        if self.learned or not self.speed:
            return self.start()
        return dataclasses.replace(self, learned=True).start()

    def start(self) -> Parameters:
        """`log_speed` [] if learned."""
        if self.learned:
            return {"log_speed": np.log(self.speed)}
        return {}

    def observed(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """See `Cnd.observed`."""
        if not (self.learned or self.fades):
            return super().observed(parameters, positions, valid, period)
        probabilities = soft_symbols(
            positions[:, None],
            positions,
            temperature=period * value_of(parameters, self, "temperature"),
            straight_through=not self.fades,
            **self.thresholds(parameters, period),
        )
        return soft_alpha(probabilities, parameters.get("table"))


@dataclasses.dataclass(frozen=True)
class Soft(Quantised):
    """The expectation of `cnd` where symbols fade into each other over `temperature`, see `soft`.

    Training can change the threshold, the temperature and the table.
    """

    title = "soft"
    fades: ClassVar[bool] = True

    def start(self) -> Parameters:
        """`log_speed` [], `log_temperature` [], `table` [81], `unobserved` []."""
        own = {
            "log_temperature": np.log(self.temperature),
            "table": self.state_weights(),
        }
        if self.learned:
            return {**super().start(), **own, "unobserved": 0.0}
        return {}


@dataclasses.dataclass(frozen=True)
class Shuffled(Cnd):
    """The weights of `quantised` with the wrong pairs, and the last step first.

    Each neighbour of an agent gets those of the next nearer one at the last position,
    the nearest those of the farthest: the same weights in the same scene, without their
    meaning. The order follows from the scene alone: neither rotation nor padding nor
    the order of agents changes it.
    """

    title = "shuffled"
    speed: NotNegative = 0.125

    def observed(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """See `Cnd.observed`."""
        observed = super().observed(parameters, positions, valid, period)
        others = other_pairs(valid)
        last = positions[:, -1]
        square_distance = jnp.square(last[:, None] - last[None]).sum(axis=-1)
        order = jnp.argsort(jnp.where(others, square_distance, jnp.inf), axis=1)
        rank = jnp.argsort(order, axis=1)
        count = jnp.maximum(others.sum(axis=1, keepdims=True), 1)
        source = jnp.take_along_axis(order, (rank - 1) % count, axis=1)
        return jnp.take_along_axis(observed[..., ::-1], source[..., None], axis=1)


@dataclasses.dataclass(frozen=True)
class Ones(Weighting):
    """1 for every pair at every step, observed or not: the neural part alone."""

    title = "ones"
    value: ClassVar[float] = 1.0

    def weigh(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """See `Weighting.weigh`."""
        agents, steps, _ = positions.shape
        return jnp.full((agents, agents, steps), self.value, positions.dtype)


@dataclasses.dataclass(frozen=True)
class Zeros(Ones):
    """0 for every pair, except of an agent for itself.

    The released training had these weights with the authors' table, because its reader
    took the first character of a label such as `0.0625`.
    """

    title = "zeros"
    value: ClassVar[float] = 0.0


WEIGHTINGS: Registry[type[Weighting]] = Registry(
    "weighting",
    {
        weighting.title: weighting
        for weighting in (
            Cnd,
            CndShipped,
            Quantised,
            Soft,
            Learned,
            Ones,
            Zeros,
            Shuffled,
        )
    },
)


class FunctionWeighting(Weighting):
    """A weighting by a function `(positions [N, T, 2], valid [N], **parameters) -> [N, N, T]`."""

    function: ClassVar[Callable[..., Array]]
    takes_period: ClassVar[bool]
    """Whether the function has an argument `period`, seconds."""

    def weigh(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """See `Weighting.weigh`."""
        arguments = dict(vars(self))
        if self.takes_period:
            arguments["period"] = period
        return type(self).function(positions, valid, **arguments, **parameters)

    def __reduce__(self):
        # Its class is in no module: another process finds it by its name.
        return _registered, (self.title, vars(self))


def _registered(name: str, options: Mapping[str, Any]) -> Weighting:
    return WEIGHTINGS[name](**options)


def _function_class(
    name: str, function: Callable[..., Array], start: Parameters
) -> type[FunctionWeighting]:
    """The weighting of a function; its arguments with a default value are options."""
    fields = []
    arguments = inspect.signature(function).parameters
    for argument in arguments.values():
        has_default = argument.default is not argument.empty
        if has_default and argument.name not in {*start, "period", "valid"}:
            option = dataclasses.field(default=argument.default)
            fields.append((argument.name, type(argument.default), option))
    takes_period = "period" in arguments
    period = {"period": None} if takes_period else {}
    try:
        inspect.signature(function).bind(None, None, **start, **period)
    except TypeError as error:
        names = ", ".join(["positions", "valid", *start])
        raise InputError(
            f"weighting {name}: must be a function ({names}), with options that have "
            f"defaults: {error}"
        ) from None
    methods = {
        "function": staticmethod(function),
        "start": lambda _: start,
        "takes_period": takes_period,
    }
    return dataclasses.make_dataclass(
        name, fields, bases=(FunctionWeighting,), namespace=methods, frozen=True
    )


def register_weighting(
    name: str, *, replace: bool = False, **start: Any
) -> Callable[[Any], Any]:
    """Register the decorated function or class as a weighting.

    A function is `(positions [N, T, 2], valid [N], **parameters) -> alpha [N, N, T]`,
    and gets the seconds between steps where it has an argument `period`. Arguments with
    a default value are options: `--weighting near,reach=2.0`. A class is a
    `Weighting`, a frozen dataclass whose fields are its options. Weights of an agent
    for itself, in padding, alone and where a position is not there are set afterwards
    (`Weighting.alpha`).

    `start` are initial values of a function's learnable parameters; `replace` replaces
    another weighting of this name.

    Raises:
        InputError: for `start` of a class, whose fields have defaults, for a function
            of other arguments, and for a taken name or none.
    """
    WEIGHTINGS.refuse_name(name)

    def register(weighting: Any) -> Any:
        is_class = isinstance(weighting, type)
        if is_class and start:
            raise InputError(
                f"{name}: initial values of a class are its fields' defaults"
            )
        cls: Any = weighting
        if not is_class:
            WEIGHTINGS.refuse_taken(name, replace)
            cls = _function_class(name, weighting, start)
        WEIGHTINGS.register(name, cls, replace=replace)
        cls.title = name
        return weighting

    return register


def make_weighting(
    weighting: Weighting | str = "cnd",
    parameters: Parameters | None = None,
    *,
    period: float = 0.4,
) -> Callable[..., Array]:
    """A function `(positions [N, T, 2], valid [N] or None) -> alpha [N, N, T]`, see `alpha`.

    `weighting` is an instance, or text such as `soft,temperature=0.1`; `parameters` are
    trained ones, by default the initial ones; `period` is in seconds.

    Raises:
        InputError: for an unknown name or option, and a period that is not positive.
    """
    refuse(Positive, {"period": period})
    is_text = isinstance(weighting, str)
    chosen = component(weighting, WEIGHTINGS, "weighting") if is_text else weighting
    values = initial_parameters(chosen) if parameters is None else parameters
    return functools.partial(chosen.alpha, values, period=period)
