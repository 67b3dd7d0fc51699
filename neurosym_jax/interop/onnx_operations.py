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
    exponent = eqn.params.get("y", 2)
    dtype = eqn.invars[0].aval.dtype
    return graph.add("Pow", x, np.asarray(exponent, dtype))


@_translates("rsqrt", "ne")
def _two_operators(graph, eqn, *values):
    operators = {"rsqrt": ("Sqrt", "Reciprocal"), "ne": ("Equal", "Not")}
    first, second = operators[eqn.primitive.name]
    inner = graph.add(first, *values)
    return graph.add(second, inner)


@_translates("optimization_barrier")
def _barrier(graph, eqn, *values):
    return values


@_translates("log1p")
def _log1p(graph, eqn, x):
    total = graph.add("Add", x, np.float32(1))
    return graph.add("Log", total)


@_translates("expm1")
def _expm1(graph, eqn, x):
    power = graph.add("Exp", x)
    return graph.add("Sub", power, np.float32(1))


@_translates("is_finite")
def _is_finite(graph, eqn, x):
    zero = graph.add("Mul", x, np.float32(0))
    return graph.add("Equal", zero, zero)


@_translates("clamp")
def _clamp(graph, eqn, low, x, high):
    raised = graph.add("Max", x, low)
    return graph.add("Min", raised, high)


@_translates("select_n")
def _select_n(graph, eqn, condition, *cases):
    if len(cases) != 2:
        raise InputError("ONNX: a choice among more than two arrays has no translation")
    otherwise, then = cases
    return graph.add("Where", condition, then, otherwise)


@_translates("convert_element_type")
def _convert(graph, eqn, x):
    return graph.cast(x, eqn.params["new_dtype"])


@_translates(*REDUCTIONS)
def _reduce(graph, eqn, x):
    operator = REDUCTIONS[eqn.primitive.name]
    axes = graph.integers(*eqn.params["axes"])
    if not _is(eqn.invars[0].aval.dtype, np.bool_):
        return graph.add(operator, x, axes, keepdims=0)
    number = graph.cast(x, np.int32)
    reduced = graph.add(operator, number, axes, keepdims=0)
    return graph.cast(reduced, np.bool_)


@_translates("argmax", "argmin")
def _arg_extreme(graph, eqn, x):
    operator = {"argmax": "ArgMax", "argmin": "ArgMin"}[eqn.primitive.name]
    (axis,) = eqn.params["axes"]
    index = graph.add(operator, x, axis=axis, keepdims=0)
    return graph.cast(index, np.int32)


@_translates("cumsum")
def _cumsum(graph, eqn, x):
    axis = np.int32(eqn.params["axis"])
    is_reverse = int(eqn.params["reverse"])
    return graph.add("CumSum", x, axis, reverse=is_reverse)


@_translates("dot_general")
def _dot_general(graph, eqn, left, right):
    contracted, batch = eqn.params["dimension_numbers"]
    ranks = []
    factors = []
    for value, variable in zip((left, right), eqn.invars):
        ranks.append(len(variable.aval.shape))
        # ONNX multiplies floats only.
        if _is(variable.aval.dtype, np.floating):
            factors.append(value)
        else:
            factors.append(graph.cast(value, np.float32))
    if _is_matrix_product(contracted, batch, ranks):
        product = graph.add("MatMul", *factors)
    else:
        equation = _einsum(contracted, batch, ranks)
        product = graph.add("Einsum", *factors, equation=equation)
    dtype = eqn.outvars[0].aval.dtype
    if _is(dtype, np.floating):
        return product
    return graph.cast(product, dtype)


def _is_matrix_product(contracted: Any, batch: Any, ranks: list[int]) -> bool:
    """Whether a general product is a `MatMul`: of matrices, or of equal batches of them."""
    left, right = ranks
    lead = list(range(len(batch[0])))
    if right != len(lead) + 2 or (lead and left != right):
        return False
    are_first = list(batch[0]) == list(batch[1]) == lead
    is_last = list(contracted[0]) == [left - 1]
    is_next = list(contracted[1]) == [len(lead)]
    return are_first and is_last and is_next


def _einsum(contracted: Any, batch: Any, ranks: list[int]) -> str:
    """The equation of a general product; of the result, shared axes come first."""
    letters = iter(LETTERS)
    left, right = ([""] * rank for rank in ranks)
    for left_axis, right_axis in (*zip(*batch), *zip(*contracted)):
        left[left_axis] = right[right_axis] = next(letters)
    result = [left[axis] for axis in batch[0]]
    for side in (left, right):
        for axis, letter in enumerate(side):
            if not letter:
                side[axis] = next(letters)
                result.append(side[axis])
    return f"{''.join(left)},{''.join(right)}->{''.join(result)}"


# -- shapes
# --------------------------------------------------------------------------------------


@_translates("reshape", "squeeze", "expand_dims")
def _reshape(graph, eqn, x, *_):
    return graph.reshape(x, eqn.outvars[0].aval.shape)


@_translates("broadcast_in_dim")
def _broadcast_in_dim(graph, eqn, x, *_):
    before = eqn.invars[0].aval.shape
    after = eqn.outvars[0].aval.shape
    axes = eqn.params["broadcast_dimensions"]
    added = [axis for axis in range(len(after)) if axis not in axes]
    if added:
        x = graph.add("Unsqueeze", x, graph.integers(*added))
    wide = [1] * len(after)
    for axis, size in zip(axes, before):
        wide[axis] = size
    if tuple(wide) == tuple(after):
        return x
    return graph.add("Expand", x, graph.shape(after))


@_translates("transpose")
def _transpose(graph, eqn, x):
    return graph.add("Transpose", x, perm=list(eqn.params["permutation"]))


@_translates("concatenate")
def _concatenate(graph, eqn, *parts):
    return graph.add("Concat", *parts, axis=eqn.params["dimension"])


@_translates("stack")
def _stack(graph, eqn, *parts):
    axis = eqn.params["axis"]
    units = [_unsqueeze(graph, part, axis) for part in parts]
    return graph.add("Concat", *units, axis=axis)


def _unsqueeze(graph, value, axis):
    return graph.add("Unsqueeze", value, graph.integers(axis))


@_translates("split")
def _split(graph, eqn, x):
    inputs = [graph.name(x), graph.integers(*eqn.params["sizes"])]
    names = [graph.fresh() for _ in eqn.outvars]
    return graph.add_many("Split", inputs, names, axis=eqn.params["axis"])


@_translates("unstack")
def _unstack(graph, eqn, x):
    axis = eqn.params["axis"]
    rows = range(len(eqn.outvars))
    return [graph.add("Gather", x, np.int32(row), axis=axis) for row in rows]


@_translates("slice")
def _slice(graph, eqn, x):
    params = eqn.params
    rank = len(eqn.invars[0].aval.shape)
    strides = params["strides"] or (1,) * rank
    starts = graph.shape(params["start_indices"])
    ends = graph.shape(params["limit_indices"])
    return graph.slice(x, range(rank), starts, ends, strides)


@_translates("dynamic_slice")
def _dynamic_slice(graph, eqn, x, *starts):
    shape = eqn.invars[0].aval.shape
    size = graph.shape(eqn.params["slice_sizes"])
    units = [_unsqueeze(graph, start, 0) for start in starts]
    start = graph.add("Concat", *units, axis=0)
    start = graph.add("Cast", start, to=INT64)
    # Like `lax.dynamic_slice`, a start is moved so that the slice lies inside.
    start = graph.add("Max", start, graph.integers(0))
    room = graph.add("Sub", graph.shape(shape), size)
    start = graph.add("Min", start, room)
    end = graph.add("Add", start, size)
    strides = (1,) * len(shape)
    return graph.slice(x, range(len(shape)), start, end, strides)


@_translates("rev")
def _rev(graph, eqn, x):
    axes = eqn.params["dimensions"]
    back = [-1] * len(axes)
    beyond = [-(2**31)] * len(axes)
    starts = graph.integers(*back)
    return graph.slice(x, axes, starts, graph.integers(*beyond), back)


@_translates("pad")
def _pad(graph, eqn, x, padding):
    low, high, inner = zip(*eqn.params["padding_config"])
    if any(inner):
        raise InputError("ONNX: padding between elements has no translation")
    widths = graph.shape([*low, *high])
    if not _is(eqn.invars[0].aval.dtype, np.bool_):
        return graph.add("Pad", x, widths, padding)
    number = graph.cast(x, np.int32)
    padded = graph.add("Pad", number, widths, graph.cast(padding, np.int32))
    return graph.cast(padded, np.bool_)


@_translates("iota")
def _iota(graph, eqn, *_):
    shape = eqn.params["shape"]
    axis = eqn.params["dimension"]
    start = graph.number(0)
    end = graph.reshape(graph.size(shape[axis]), ())
    step = graph.number(1)
    count = graph.add("Range", start, end, step)
    count = graph.cast(count, eqn.params["dtype"])
    unit = [1] * len(shape)
    unit[axis] = shape[axis]
    count = graph.reshape(count, unit)
    return graph.add("Expand", count, graph.shape(shape))


@_translates("dim_as_value")
def _dim_as_value(graph, eqn, *_):
    size = graph.size(eqn.params["dim"])
    return graph.cast(graph.reshape(size, ()), np.int32)


@_translates("gather")
def _gather(graph, eqn, x, indices):
    """Elements, rows or windows at indices, see `lax.gather`.

    Constant indices are slices; an index into one axis is a `Gather`; into several, a
    `GatherND`.
    """
    numbers = eqn.params["dimension_numbers"]
    axes = numbers.start_index_map
    shape = eqn.invars[0].aval.shape
    out = eqn.outvars[0].aval.shape
    if not isinstance(indices, str) and np.ndim(indices) == 1:
        part = _window(graph, eqn, x, indices)
        return graph.reshape(part, out)
    batch = len(numbers.operand_batching_dims)
    free = _free_axes(numbers, shape, eqn.params["slice_sizes"])

    inside = graph.add("Max", indices, np.int32(0))
    last = _last_indices(graph, [shape[axis] for axis in axes])
    inside = graph.add("Min", inside, last)
    order = [*numbers.operand_batching_dims, *axes, *free]
    rows = graph.add("Transpose", x, perm=order)
    places = graph.add("Cast", inside, to=INT64)
    rows = graph.add("GatherND", rows, places, batch_dims=batch)
    # The result has the axes of the indices first; jax says where the others are.
    offsets = numbers.offset_dims
    lead = [axis for axis in range(len(out)) if axis not in offsets]
    source = np.argsort([*lead, *offsets]).tolist()
    result = graph.add("Transpose", rows, perm=source)
    if "FILL" not in str(eqn.params["mode"]):
        return result

    fill = eqn.params["fill_value"]
    dtype = eqn.outvars[0].aval.dtype
    if fill is None:
        smallest = np.iinfo(np.int32).min
        fill = np.nan if _is(dtype, np.floating) else smallest
    hit = graph.add("Equal", indices, inside)
    hit = graph.cast(hit, np.int32)
    hit = graph.add("ReduceMin", hit, graph.integers(-1), keepdims=0)
    hit = graph.cast(hit, np.bool_)
    for axis in offsets:
        hit = _unsqueeze(graph, hit, axis)
    return graph.add("Where", hit, result, np.asarray(fill, dtype))


def _window(graph, eqn, x, indices):
    """The slice at constant indices, moved so that it lies inside, as `lax.gather` does."""
    axes = eqn.params["dimension_numbers"].start_index_map
    shape = eqn.invars[0].aval.shape
    starts, ends = [], []
    for start, axis in zip(indices, axes):
        size = eqn.params["slice_sizes"][axis]
        start = int(np.clip(start, 0, shape[axis] - size))
        starts.append(start)
        ends.append(start + size)
    strides = [1] * len(axes)
    first = graph.integers(*starts)
    return graph.slice(x, axes, first, graph.shape(ends), strides)


def _free_axes(numbers, shape, sizes):
    """The axes of a gathered array that no index is of.

    Raises:
        InputError: for what `GatherND` does not do.
    """
    axes = numbers.start_index_map
    batching = numbers.operand_batching_dims
    indexed = {*axes, *batching}
    free = [axis for axis in range(len(shape)) if axis not in indexed]
    are_elements = set(numbers.collapsed_slice_dims) == set(axes)
    are_whole = all(sizes[axis] == shape[axis] for axis in free)
    if not are_elements or not are_whole:
        raise InputError(
            "ONNX: windows at indices that depend on the input have no translation"
        )
    if tuple(numbers.start_indices_batching_dims) != tuple(range(len(batching))):
        raise InputError(
            "ONNX: a batch of indices along a later axis has no translation"
        )
    return free


def _last_indices(graph, sizes):
    """The last index into each of several axes, of which some may have a size by a symbol."""
    if all(isinstance(size, int) for size in sizes):
        return np.array(sizes, np.int32) - np.int32(1)
    ends = graph.add("Sub", graph.shape(sizes), graph.integers(1))
    return graph.cast(ends, np.int32)
