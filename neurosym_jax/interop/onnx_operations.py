"""Operations of jaxprs that take more than one operator of ONNX, for `onnx`.

Each is `(graph, equation, *values) -> value`, or values where the operation has several
results.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["REDUCTIONS", "TRANSLATIONS"]

REDUCTIONS = {
    "reduce_max": "ReduceMax", "reduce_min": "ReduceMin", "reduce_prod": "ReduceProd",
    "reduce_sum": "ReduceSum", "reduce_and": "ReduceMin", "reduce_or": "ReduceMax",
}  # fmt: skip
INT64 = 7
"""ONNX's number of the type."""
LETTERS = "abcdefghijklmnopqrstuvwxyz"

TRANSLATIONS: dict[str, Callable[..., Any]] = {}


def _translates(*primitives: str) -> Callable[[Any], Any]:
    def register(translation: Any) -> Any:
        TRANSLATIONS.update((primitive, translation) for primitive in primitives)
        return translation

    return register


def _is(dtype: Any, kind: type) -> bool:
    return np.issubdtype(dtype, kind)


# -- numbers
# -------------------------------------------------------------------------------------


@_translates("integer_pow", "square")
def _integer_pow(graph, eqn, x):
    exponent = np.asarray(eqn.params.get("y", 2), eqn.invars[0].aval.dtype)
    return graph.add("Pow", [graph.name(x), graph.name(exponent)])


@_translates("rsqrt", "ne")
def _two_operators(graph, eqn, *values):
    operators = {"rsqrt": ("Sqrt", "Reciprocal"), "ne": ("Equal", "Not")}[
        eqn.primitive.name
    ]
    return graph.add(
        operators[1], [graph.add(operators[0], list(map(graph.name, values)))]
    )


@_translates("log1p")
def _log1p(graph, eqn, x):
    return graph.add(
        "Log", [graph.add("Add", [graph.name(x), graph.name(np.float32(1))])]
    )


@_translates("expm1")
def _expm1(graph, eqn, x):
    return graph.add(
        "Sub", [graph.add("Exp", [graph.name(x)]), graph.name(np.float32(1))]
    )


@_translates("is_finite")
def _is_finite(graph, eqn, x):
    zero = graph.add("Mul", [graph.name(x), graph.name(np.float32(0))])
    return graph.add("Equal", [zero, zero])


@_translates("clamp")
def _clamp(graph, eqn, low, x, high):
    raised = graph.add("Max", [graph.name(x), graph.name(low)])
    return graph.add("Min", [raised, graph.name(high)])


@_translates("select_n")
def _select_n(graph, eqn, condition, *cases):
    if len(cases) != 2:
        raise InputError("ONNX: a choice among more than two arrays has no translation")
    return graph.add(
        "Where", [graph.name(condition), graph.name(cases[1]), graph.name(cases[0])]
    )


@_translates("convert_element_type")
def _convert(graph, eqn, x):
    return graph.cast(x, eqn.params["new_dtype"])


@_translates(*REDUCTIONS)
def _reduce(graph, eqn, x):
    boolean = _is(eqn.invars[0].aval.dtype, np.bool_)
    inputs = [graph.cast(x, np.int32) if boolean else graph.name(x)]
    inputs += [graph.integers(*eqn.params["axes"])]
    reduced = graph.add(REDUCTIONS[eqn.primitive.name], inputs, keepdims=0)
    return graph.cast(reduced, np.bool_) if boolean else reduced


@_translates("argmax", "argmin")
def _arg_extreme(graph, eqn, x):
    operator = {"argmax": "ArgMax", "argmin": "ArgMin"}[eqn.primitive.name]
    (axis,) = eqn.params["axes"]
    return graph.cast(
        graph.add(operator, [graph.name(x)], axis=axis, keepdims=0), np.int32
    )


@_translates("cumsum")
def _cumsum(graph, eqn, x):
    inputs = [graph.name(x), graph.name(np.int32(eqn.params["axis"]))]
    return graph.add("CumSum", inputs, reverse=int(eqn.params["reverse"]))


@_translates("dot_general")
def _dot_general(graph, eqn, left, right):
    (contracted, batch), shapes = (
        eqn.params["dimension_numbers"],
        [v.aval for v in eqn.invars],
    )
    # ONNX multiplies floats only.
    names = [
        graph.name(value)
        if _is(aval.dtype, np.floating)
        else graph.cast(value, np.float32)
        for value, aval in zip((left, right), shapes)
    ]
    ranks = [len(aval.shape) for aval in shapes]
    lead = tuple(range(len(batch[0])))
    plain = ranks[1] == len(lead) + 2 and (ranks[0] == ranks[1] or not lead)
    if (
        plain
        and tuple(batch[0]) == tuple(batch[1]) == lead
        and tuple(contracted[0]) == (ranks[0] - 1,)
        and tuple(contracted[1]) == (len(lead),)
    ):
        product = graph.add("MatMul", names)
    else:
        product = graph.add("Einsum", names, equation=_einsum(contracted, batch, ranks))
    dtype = eqn.outvars[0].aval.dtype
    if _is(dtype, np.floating):
        return product
    return graph.cast(product, dtype)


def _einsum(contracted: Any, batch: Any, ranks: list[int]) -> str:
    """The equation of a general product; of the result, shared axes come first."""
    letters = iter(LETTERS)
    sides = [[""] * rank for rank in ranks]
    for left, right in (*zip(*batch), *zip(*contracted)):
        sides[0][left] = sides[1][right] = next(letters)
    free = [[axis for axis, letter in enumerate(side) if not letter] for side in sides]
    for side, axes in zip(sides, free):
        for axis in axes:
            side[axis] = next(letters)
    result = [sides[0][axis] for axis in batch[0]]
    result += [side[axis] for side, axes in zip(sides, free) for axis in axes]
    return f"{''.join(sides[0])},{''.join(sides[1])}->{''.join(result)}"


# -- shapes
# --------------------------------------------------------------------------------------


@_translates("reshape", "squeeze", "expand_dims")
def _reshape(graph, eqn, x, *_):
    return graph.reshape(x, eqn.outvars[0].aval.shape)


@_translates("broadcast_in_dim")
def _broadcast_in_dim(graph, eqn, x, *_):
    before, after = eqn.invars[0].aval.shape, eqn.outvars[0].aval.shape
    axes = eqn.params["broadcast_dimensions"]
    name = graph.name(x)
    added = [axis for axis in range(len(after)) if axis not in axes]
    if added:
        name = graph.add("Unsqueeze", [name, graph.integers(*added)])
    wide = [1] * len(after)
    for axis, size in zip(axes, before):
        wide[axis] = size
    if tuple(wide) == tuple(after):
        return name
    return graph.add("Expand", [name, graph.shape(after)])


@_translates("transpose")
def _transpose(graph, eqn, x):
    return graph.add("Transpose", [graph.name(x)], perm=list(eqn.params["permutation"]))


@_translates("concatenate")
def _concatenate(graph, eqn, *parts):
    return graph.add(
        "Concat", list(map(graph.name, parts)), axis=eqn.params["dimension"]
    )


@_translates("stack")
def _stack(graph, eqn, *parts):
    axis = eqn.params["axis"]
    units = [
        graph.add("Unsqueeze", [graph.name(x), graph.integers(axis)]) for x in parts
    ]
    return graph.add("Concat", units, axis=axis)


@_translates("split")
def _split(graph, eqn, x):
    inputs = [graph.name(x), graph.integers(*eqn.params["sizes"])]
    names = [graph.fresh() for _ in eqn.outvars]
    return graph.add_many("Split", inputs, names, axis=eqn.params["axis"])


@_translates("slice")
def _slice(graph, eqn, x):
    params, shape = eqn.params, eqn.invars[0].aval.shape
    strides = params["strides"] or (1,) * len(shape)
    starts = graph.shape(params["start_indices"])
    ends = graph.shape(params["limit_indices"])
    return graph.slice(x, range(len(shape)), starts, ends, strides)


@_translates("dynamic_slice")
def _dynamic_slice(graph, eqn, x, *starts):
    sizes, shape = eqn.params["slice_sizes"], eqn.invars[0].aval.shape
    # Like `lax.dynamic_slice`, a start is moved so that the slice lies inside.
    units = [graph.add("Unsqueeze", [graph.name(s), graph.integers(0)]) for s in starts]
    start = graph.add("Cast", [graph.add("Concat", units, axis=0)], to=INT64)
    room = graph.add("Sub", [graph.shape(shape), graph.shape(sizes)])
    start = graph.add("Min", [graph.add("Max", [start, graph.integers(0)]), room])
    end = graph.add("Add", [start, graph.shape(sizes)])
    return graph.slice(x, range(len(shape)), start, end, (1,) * len(shape))


@_translates("rev")
def _rev(graph, eqn, x):
    axes = eqn.params["dimensions"]
    starts = graph.integers(*[-1] * len(axes))
    ends = graph.integers(*[-(2**31)] * len(axes))
    return graph.slice(x, axes, starts, ends, [-1] * len(axes))


@_translates("pad")
def _pad(graph, eqn, x, padding):
    low, high, inner = zip(*eqn.params["padding_config"])
    if any(inner):
        raise InputError("ONNX: padding between elements has no translation")
    boolean = _is(eqn.invars[0].aval.dtype, np.bool_)
    values = [
        graph.cast(v, np.int32) if boolean else graph.name(v) for v in (x, padding)
    ]
    padded = graph.add("Pad", [values[0], graph.shape([*low, *high]), values[1]])
    return graph.cast(padded, np.bool_) if boolean else padded


@_translates("iota")
def _iota(graph, eqn, *_):
    shape, axis = eqn.params["shape"], eqn.params["dimension"]
    end = graph.reshape(graph.size(shape[axis]), ())
    count = graph.add("Range", [graph.number(0), end, graph.number(1)])
    count = graph.cast(count, eqn.params["dtype"])
    unit = [shape[axis] if place == axis else 1 for place in range(len(shape))]
    count = graph.reshape(count, unit)
    return graph.add("Expand", [count, graph.shape(shape)])


@_translates("dim_as_value")
def _dim_as_value(graph, eqn, *_):
    return graph.cast(graph.reshape(graph.size(eqn.params["dim"]), ()), np.int32)


@_translates("gather")
def _gather(graph, eqn, x, indices):
    """Elements, rows or windows at indices, see `lax.gather`.

    Constant indices are slices; an index into one axis is a `Gather`; into several, a
    `GatherND`.
    """
    numbers, sizes = eqn.params["dimension_numbers"], eqn.params["slice_sizes"]
    axes, shape = numbers.start_index_map, eqn.invars[0].aval.shape
    out = eqn.outvars[0].aval.shape
    if not isinstance(indices, str) and np.ndim(indices) == 1:
        limits = [shape[axis] - sizes[axis] for axis in axes]
        inside = [
            int(np.clip(start, 0, limit)) for start, limit in zip(indices, limits)
        ]
        ends = [start + sizes[axis] for start, axis in zip(inside, axes)]
        part = graph.slice(
            x, axes, graph.integers(*inside), graph.shape(ends), [1] * len(axes)
        )
        return graph.reshape(part, out)
    batching = numbers.operand_batching_dims
    free = [axis for axis in range(len(shape)) if axis not in (*axes, *batching)]
    if set(numbers.collapsed_slice_dims) != set(axes) or any(
        sizes[axis] != shape[axis] for axis in free
    ):
        raise InputError(
            "ONNX: windows at indices that depend on the input have no translation"
        )
    last = [
        np.int32(shape[axis] - 1) if isinstance(shape[axis], int) else None
        for axis in axes
    ]
    if None in last:
        ends = graph.add(
            "Sub", [graph.shape([shape[a] for a in axes]), graph.integers(1)]
        )
        last = graph.cast(ends, np.int32)
    inside = graph.add("Max", [graph.name(indices), graph.name(np.int32(0))])
    inside = graph.add(
        "Min", [inside, graph.name(last if isinstance(last, str) else np.array(last))]
    )
    order = [*batching, *axes, *free]
    rows = graph.add("Transpose", [graph.name(x)], perm=order)
    if tuple(numbers.start_indices_batching_dims) != tuple(range(len(batching))):
        raise InputError(
            "ONNX: a batch of indices along a later axis has no translation"
        )
    rows = graph.add(
        "GatherND",
        [rows, graph.add("Cast", [inside], to=INT64)],
        batch_dims=len(batching),
    )
    # The result has the axes of the indices first; jax says where the others are.
    rank = len(out)
    offsets = numbers.offset_dims
    lead = [place for place in range(rank) if place not in offsets]
    source = {place: number for number, place in enumerate([*lead, *offsets])}
    result = graph.add(
        "Transpose", [rows], perm=[source[place] for place in range(rank)]
    )
    if "FILL" not in str(eqn.params["mode"]):
        return result
    fill = eqn.params["fill_value"]
    dtype = eqn.outvars[0].aval.dtype
    missing = np.nan if _is(dtype, np.floating) else np.iinfo(np.int32).min
    hit = graph.add("Equal", [graph.name(indices), inside])
    hit = graph.cast(hit, np.int32)
    hit = graph.add("ReduceMin", [hit, graph.integers(-1)], keepdims=0)
    hit = graph.cast(hit, np.bool_)
    for place in offsets:
        hit = graph.add("Unsqueeze", [hit, graph.integers(place)])
    value = np.asarray(missing if fill is None else fill, dtype)
    return graph.add("Where", [hit, result, graph.name(value)])
