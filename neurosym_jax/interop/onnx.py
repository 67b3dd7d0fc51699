"""A JAX function as an ONNX model: its jaxpr, equation by equation, in operators of ONNX.

`to_onnx` traces a function for arguments whose sizes may be symbols
(`jax.export.symbolic_shape`), computes what depends on constants alone, and writes the
rest with `onnx.helper`. It knows the operations that our networks consist of and
refuses others by name; a changed network needs no change here. Short loops are
unrolled, others become a `Scan`. ONNX Runtime lacks operators for small integers, so
all integers are int32; a product of booleans is one of floats.
"""

import ast
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.errors import InputError, optional_module
from neurosym_jax.interop.onnx_operations import TRANSLATIONS

__all__ = ["to_onnx"]

OPSET, IR_VERSION = 18, 9
UNROLLED = 64
"""Longest loop over an array that is written out step by step."""

# Operations that are one operator of ONNX, argument by argument.
OPERATORS = {
    "abs": "Abs", "add": "Add", "and": "And", "ceil": "Ceil", "cos": "Cos", "div": "Div",
    "eq": "Equal", "erf": "Erf", "exp": "Exp", "floor": "Floor", "ge": "GreaterOrEqual",
    "gt": "Greater", "le": "LessOrEqual", "log": "Log", "logistic": "Sigmoid", "lt": "Less",
    "max": "Max", "min": "Min", "mul": "Mul", "neg": "Neg", "not": "Not", "or": "Or", "pow": "Pow",
    "round": "Round", "sign": "Sign", "sin": "Sin", "sqrt": "Sqrt", "sub": "Sub", "tan": "Tan",
    "tanh": "Tanh", "xor": "Xor",
}  # fmt: skip
IDENTITIES = {"copy", "copy_p", "optimization_barrier", "stop_gradient"}
CALLS = ("jaxpr", "call_jaxpr", "fun_jaxpr")
"""Parameters of an equation that may hold the function which it calls."""


def to_onnx(
    function: Callable[..., Any],
    arguments: Mapping[str, jax.ShapeDtypeStruct],
    outputs: Sequence[str],
    properties: Mapping[str, str],
) -> bytes:
    """The ONNX model of `function`, serialised.

    Args:
        function: from float32 arrays to a tuple of arrays.
        arguments: shape of each argument by its name in the model; sizes may be
            symbols, whose names are then those of the model's free sizes.
        outputs: names of the arrays returned.
        properties: metadata of the model.

    Raises:
        InputError: without onnx, and for an operation that has no translation.
    """
    onnx = optional_module("onnx", "exporting to ONNX", "onnx")
    with jax.enable_x64(False):
        closed = jax.jit(function).trace(*arguments.values()).jaxpr
        graph = _Graph(onnx)
        for name, argument in arguments.items():
            graph.declare_sizes(name, argument.shape)
        results = graph.translate(closed.jaxpr, closed.consts, list(arguments))
    for name, result in zip(outputs, results):
        graph.add("Identity", result, name=name)
    make = onnx.helper
    body = make.make_graph(
        graph.nodes,
        "forecast",
        graph.infos(arguments, arguments.values()),
        graph.infos(outputs, (var.aval for var in closed.jaxpr.outvars)),
        graph.constants,
    )
    opset = make.make_opsetid("", OPSET)
    model = make.make_model(body, opset_imports=[opset], ir_version=IR_VERSION)
    make.set_model_props(model, dict(properties))
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _scan_counts(params: Mapping[str, Any]) -> tuple[int, int]:
    """How many inputs of a loop are constants, and how many are carried from step to step."""
    if "num_consts" in params:
        return params["num_consts"], params["num_carry"]
    # Later versions than 0.10 have a tree of all inputs instead.
    constants, carry, _rows = params["ft_in"].unpack()
    return len(constants), len(carry)


class _Graph:
    """Nodes and constants of a graph that is being written; a loop's body shares its constants.

    A value is the name of a result, or a numpy array where it does not depend on an
    argument.
    """

    def __init__(self, onnx: Any, outer: "_Graph | None" = None):
        self.onnx = onnx
        self.nodes = []
        self.constants = []
        self.numbers = itertools.count(1)
        self.sizes: dict[str, str] = {}
        if outer is not None:
            self.constants = outer.constants
            self.numbers = outer.numbers
            self.sizes = outer.sizes

    # -- writing
    # ---------------------------------------------------------------------------------

    def add(
        self, operator: str, *values: Any, name: str = "", **attributes: Any
    ) -> str:
        """Add a node with one result; return its name."""
        inputs = [self.name(value) for value in values]
        name = name or self.fresh()
        self.add_many(operator, inputs, [name], **attributes)
        return name

    def add_many(
        self, operator: str, inputs: list[str], names: list[str], **attributes: Any
    ) -> list[str]:
        """Add a node with results called `names`."""
        node = self.onnx.helper.make_node(operator, inputs, names, **attributes)
        self.nodes.append(node)
        return names

    def fresh(self) -> str:
        """A new name."""
        return f"v{next(self.numbers)}"

    def name(self, value: Any) -> str:
        """The name of a value; an array becomes a constant of the model."""
        if isinstance(value, str):
            return value
        array = np.asarray(value)
        kind = _kind(array.dtype)
        return self._constant(array.astype(kind, order="C"))

    def integers(self, *values: int) -> str:
        """The constant [len(values)] int64, as operators take axes and shapes."""
        return self._constant(np.array(values, np.int64))

    def _constant(self, array: np.ndarray) -> str:
        name = self.fresh()
        self.constants.append(self.onnx.numpy_helper.from_array(array, name))
        return name

    def number(self, value: int) -> str:
        """The constant [] int64."""
        return self.add("Squeeze", self.integers(value))

    def element_type(self, dtype: Any) -> int:
        """ONNX's number of a type."""
        return self.onnx.helper.np_dtype_to_tensor_dtype(np.dtype(_kind(dtype)))

    def cast(self, value: Any, dtype: Any) -> str:
        """The value as another type."""
        return self.add("Cast", value, to=self.element_type(dtype))

    def infos(self, names: Iterable[str], avals: Iterable[Any]) -> list[Any]:
        """Declarations of inputs or outputs."""
        infos = []
        for name, aval in zip(names, avals):
            kind = self.element_type(aval.dtype)
            dims = [size if isinstance(size, int) else str(size) for size in aval.shape]
            info = self.onnx.helper.make_tensor_value_info(name, kind, dims)
            infos.append(info)
        return infos

    # -- sizes
    # -----------------------------------------------------------------------------------

    def declare_sizes(self, argument: str, shape: Sequence[Any]) -> None:
        """Know the symbols among the sizes of an argument."""
        for axis, size in enumerate(shape):
            if not isinstance(size, int) and str(size) not in self.sizes:
                shape_name = self.add("Shape", argument, start=axis, end=axis + 1)
                self.sizes[str(size)] = shape_name

    def size(self, size: Any) -> str:
        """The name of a size [1] int64: a number, a symbol, or a polynomial of symbols."""
        if isinstance(size, int):
            return self.integers(size)
        term = ast.parse(str(size), mode="eval").body
        return self._polynomial(term)

    def _polynomial(self, term: ast.expr) -> str:
        operators = {ast.Add: "Add", ast.Sub: "Sub", ast.Mult: "Mul"}
        match term:
            case ast.Constant(value=int(value)):
                return self.integers(value)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self.add("Neg", self._polynomial(operand))
            case ast.Name(id=name) if name in self.sizes:
                return self.sizes[name]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in operators:
                parts = [self._polynomial(left), self._polynomial(right)]
                return self.add(operators[type(op)], *parts)
        raise InputError(f"ONNX: the size {ast.unparse(term)} has no translation")

    def shape(self, sizes: Sequence[Any]) -> str:
        """The name of a shape [rank] int64."""
        if all(isinstance(size, int) for size in sizes):
            return self.integers(*sizes)
        names = [self.size(size) for size in sizes]
        return self.add("Concat", *names, axis=0)

    def reshape(self, value: Any, sizes: Sequence[Any]) -> str:
        """The value in another shape; one symbol among its sizes is left to ONNX to find."""
        numbers = [size if isinstance(size, int) else -1 for size in sizes]
        if numbers.count(-1) == 1 and 0 not in numbers:
            shape = self.integers(*numbers)
        else:
            shape = self.shape(sizes)
        return self.add("Reshape", value, shape)

    def slice(
        self, value: Any, axes: Sequence[int], starts: Any, ends: Any, steps: Any
    ) -> str:
        """Part of a value; `starts` and `ends` are names of [len(axes)] int64."""
        axes_name = self.integers(*axes)
        steps_name = self.integers(*steps)
        return self.add("Slice", value, starts, ends, axes_name, steps_name)

    # -- translating
    # -----------------------------------------------------------------------------

    def translate(
        self, jaxpr: Any, constants: Sequence[Any], inputs: Sequence[Any]
    ) -> list[Any]:
        """Values of the results of a jaxpr, given those of its constants and arguments."""
        values = dict(zip(jaxpr.constvars, map(np.asarray, constants)))
        values |= dict(zip(jaxpr.invars, inputs))

        def read(atom: Any) -> Any:
            if hasattr(atom, "val"):
                return np.asarray(atom.val)
            return values[atom]

        for eqn in jaxpr.eqns:
            eqn_inputs = [read(atom) for atom in eqn.invars]
            results = self.equation(eqn, eqn_inputs)
            values |= dict(zip(eqn.outvars, results))
        return [read(atom) for atom in jaxpr.outvars]

    def equation(self, eqn: Any, inputs: list[Any]) -> Sequence[Any]:
        """Values of the results of one equation."""
        primitive = eqn.primitive.name
        if primitive == "scan":
            return self._scan(eqn, inputs)
        for name in CALLS:
            if name in eqn.params:
                function = eqn.params[name]
                return self.translate(function.jaxpr, function.consts, inputs)
        if primitive in IDENTITIES:
            return inputs
        if _is_constant(eqn, inputs):
            return _computed(eqn, inputs)
        if primitive in OPERATORS:
            return [self.add(OPERATORS[primitive], *inputs)]
        translation = TRANSLATIONS.get(primitive)
        if translation is None:
            raise InputError(
                f"ONNX: the operation {primitive} has no translation: export a .stablehlo file"
            )
        results = translation(self, eqn, *inputs)
        if eqn.primitive.multiple_results:
            return results
        return [results]

    def _scan(self, eqn: Any, inputs: list[Any]) -> list[Any]:
        """A loop, written out, or a `Scan`, whose body reads the constants from outside."""
        length = eqn.params["length"]
        count, carried = _scan_counts(eqn.params)
        constants = inputs[:count]
        inputs = inputs[count:]
        carry = inputs[:carried]
        rows = inputs[len(carry) :]
        # ONNX has no loop without an array to loop over.
        if isinstance(length, int) and (length <= UNROLLED or not rows):
            return self._unrolled(eqn, constants, carry, rows)

        body = eqn.params["jaxpr"]
        inner = _Graph(self.onnx, self)
        arguments = body.jaxpr.invars[count:]
        names = [inner.fresh() for _ in arguments]
        constants = [self.name(constant) for constant in constants]
        results = inner.translate(body.jaxpr, body.consts, [*constants, *names])
        outputs = [inner.add("Identity", result) for result in results]
        graph = self.onnx.helper.make_graph(
            inner.nodes,
            "step",
            inner.infos(names, (var.aval for var in arguments)),
            inner.infos(outputs, (var.aval for var in body.jaxpr.outvars)),
        )
        direction = [int(eqn.params["reverse"])]
        return self.add_many(
            "Scan",
            [self.name(value) for value in inputs],
            [self.fresh() for _ in eqn.outvars],
            body=graph,
            num_scan_inputs=len(rows),
            scan_input_directions=direction * len(rows),
            scan_output_directions=direction * (len(outputs) - len(carry)),
        )

    def _unrolled(
        self, eqn: Any, constants: list[Any], carry: list[Any], rows: list[Any]
    ) -> list[Any]:
        """A loop, step after step."""
        body = eqn.params["jaxpr"]
        steps = list(range(eqn.params["length"]))
        if eqn.params["reverse"]:
            steps.reverse()
        outputs = []
        for step in steps:
            slices = []
            for row in rows:
                if isinstance(row, str):
                    slices.append(self.add("Gather", row, np.int32(step), axis=0))
                else:
                    slices.append(row[step])
            arguments = [*constants, *carry, *slices]
            results = self.translate(body.jaxpr, body.consts, arguments)
            carry = results[: len(carry)]
            units = []
            for result in results[len(carry) :]:
                units.append(self.add("Unsqueeze", result, self.integers(0)))
            outputs.append(units)
        if eqn.params["reverse"]:
            outputs.reverse()
        stacks = [self.add("Concat", *units, axis=0) for units in zip(*outputs)]
        return [*carry, *stacks]


def _is_constant(eqn: Any, inputs: Sequence[Any]) -> bool:
    """Whether an equation's results depend on no argument, nor on a size by a symbol."""
    if eqn.primitive.name == "dim_as_value":
        return False
    for variable in eqn.outvars:
        if not all(isinstance(size, int) for size in variable.aval.shape):
            return False
    return not any(isinstance(value, str) for value in inputs)


def _computed(eqn: Any, inputs: Sequence[Any]) -> list[np.ndarray]:
    """The results of an equation of constants."""
    arrays = []
    for value, variable in zip(inputs, eqn.invars):
        arrays.append(jnp.asarray(value, variable.aval.dtype))
    results = eqn.primitive.bind(*arrays, **eqn.params)
    if not eqn.primitive.multiple_results:
        results = [results]
    return [np.asarray(result) for result in results]


def _kind(dtype: Any) -> Any:
    """The type in ONNX: float32, bool, or int32 for all integers."""
    if np.issubdtype(dtype, np.bool_):
        return np.bool_
    if np.issubdtype(dtype, np.integer):
        return np.int32
    return np.float32
