"""Programs kept whole between processes: a warm process traces, lowers and compiles nothing.

JAX's own cache is asked with the lowered program, so each process traces and lowers
every program before it finds it. A `Program` is asked for by all that it follows from:
its function, static arguments, shapes, the source of this project, versions, settings
and the processor. What is not known to be the same is not used.

Only one CPU device is served, and only while every registered component is this
project's own: the source of a plugin, and of what it imports, is not known.
"""

import contextlib
import dataclasses
import enum
import functools
import hashlib
import importlib.metadata
import io
import json
import os
import pickle
import platform
import sys
import threading
import time
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np
from jax._src import config as jax_config
from jax._src.core import trace_state_clean
from jax.core import Tracer
from jax.experimental import serialize_executable

from neurosym_jax.plugins import additions
from neurosym_jax.runtime.compiled import SealedCache, apart_from_cache, private_folder
from neurosym_jax.scene import Scene

__all__ = ["Program", "full_precision", "keep_whole", "kept_json", "program"]

ROOT = Path(__file__).resolve().parents[2]
"""The folder of this project's packages."""
PACKAGES = "neurosym_"
"""How their names begin; their source is a part of every key."""
JAX_MODULES = (
    "jax._src.core",
    "jax._src.interpreters.pxla",
    "jax._src.layout",
    "jax._src.linear_util",
    "jax._src.mesh",
    "jax._src.named_sharding",
    "jax._src.partition_spec",
    "jax._src.prng",
    "jax._src.random",
    "jax._src.sharding_impls",
    "jax._src.stages",
    "jax._src.tree_util",
    "jaxlib._jax",
)
"""Modules of JAX whose classes a kept program may name."""
NODES = (PACKAGES, "optax.")
"""Modules with nodes of trees, which a kept program may name too."""
VERSIONED = ("jax", "jaxlib", "numpy", "flax", "optax")
"""Packages of which the version is."""
VARIABLES = ("XLA_FLAGS", "NPROC", "PJRT_NPROC", "JAX_PLATFORMS")
"""Variables of the environment that change what is compiled."""
UNPICKLERS = ("_unpickle_named_sharding", "_unpickle_single_device_sharding")
"""Functions of JAX that a kept program may call while it is read."""
RANDOM = ("threefry_seed", "threefry_split", "threefry_random_bits", "threefry_fold_in")
"""Functions of JAX that the type of a random key names."""
REGISTRIES = ("default_registry", "tracing_registry")
"""Objects of `jax._src.tree_util` that it may name."""

SOURCES = (".py", ".tsv")
"""Endings of files that programs follow from."""

_IMPORTED = time.time()
_cache: SealedCache | None = None


class Unnamed(Exception):
    """A value that has no name by which another process would know it."""


def keep_whole(folder: Path) -> None:
    """Keep programs from now on in `folder`, if it is, or can be made, the user's alone."""
    global _cache
    if hasattr(serialize_executable, "_JaxPjrtUnpickler") and private_folder(folder):
        _cache = SealedCache(folder)


NO_OPTIONS: Mapping[str, Any] = types.MappingProxyType({})
Options = Mapping[str, Any] | Callable[..., Mapping[str, Any]]
"""`compiler_options` of `jax.jit`, or a function of a program's static arguments that gives them."""


def program(
    static: tuple[int, ...] = (), compiler_options: Options = NO_OPTIONS, **options: Any
) -> Callable[..., "Program"]:
    """Make a function a `Program`; `static` are positions, `options` those of `jax.jit`."""
    return lambda function: Program(function, static, compiler_options, **options)


class Program:
    """`jax.jit` of a function of positional arguments, whose executables are kept.

    Where nothing is kept, it is `jax.jit`; within a trace, `jax.jit` without
    `compiler_options`, for the outermost program has its own. Products keep all bits,
    see `full_precision`.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        static: tuple[int, ...],
        compiler_options: Options = NO_OPTIONS,
        **options: Any,
    ):
        self.static = static
        self._function = full_precision(function)
        self.jitted = jax.jit(self._function, static_argnums=static, **options)
        self.name = f"{function.__module__}.{function.__qualname__} {options}"
        self._options = compiler_options
        self._jitted_for: dict[Any, Callable[..., Any]] = {}
        self._jit_options = options
        self._executables: dict[Any, Callable[..., Any]] = {}
        self._locks: dict[Any, threading.Lock] = {}
        functools.update_wrapper(self, function)

    def lower(self, *arguments: Any) -> Any:
        """See `jax.jit(...).lower`."""
        return self.jitted.lower(*arguments)

    def __call__(self, *arguments: Any) -> Any:
        """The function's result."""
        if not trace_state_clean():
            return self.jitted(*arguments)
        # One with a default may be missing.
        fixed = tuple(arguments[at] for at in self.static if at < len(arguments))
        options = self._options_of(fixed)
        compiled = self._with_options(options)
        if _cache is None:
            return compiled(*arguments)
        traced = [value for at, value in enumerate(arguments) if at not in self.static]
        leaves, tree = jax.tree.flatten(traced)
        if not all(map(_is_array, leaves)):
            return compiled(*arguments)
        shapes = tuple(map(_shape_of, leaves))
        # Settings are those of this thread, and of now.
        settings = jax_config.trace_context(), len(additions())
        key = fixed, options, tree, shapes, *settings
        executable = self._executables.get(key)
        if executable is None:
            with self._locks.setdefault(key, threading.Lock()):
                executable = self._executables.get(key)
                if executable is None:
                    executable = self._executable(
                        arguments, fixed, options, tree, shapes
                    )
                    self._executables[key] = executable
        if executable is compiled:
            return compiled(*arguments)
        return executable(*traced)

    def _with_options(self, options: tuple[tuple[str, Any], ...]) -> Any:
        """`jax.jit` with these `compiler_options`; the same object for every thread."""
        jitted = self._jitted_for.get(options)
        if jitted is None:
            new = jax.jit(
                self._function,
                static_argnums=self.static,
                compiler_options=dict(options),
                **self._jit_options,
            )
            # Another thread may have been first.
            jitted = self._jitted_for.setdefault(options, new)
        return jitted

    def _options_of(self, fixed: tuple[Any, ...]) -> tuple[tuple[str, Any], ...]:
        """Names and values of `compiler_options` for static arguments `fixed`; of a CPU alone."""
        if jax.default_backend() != "cpu":
            return ()
        options = self._options(*fixed) if callable(self._options) else self._options
        return tuple(sorted(options.items()))

    def _executable(
        self, arguments: Any, fixed: Any, options: Any, tree: Any, shapes: Any
    ) -> Callable[..., Any]:
        """The kept executable; else a new one, which is kept; else `jax.jit`."""
        assert _cache is not None
        compiled = self._with_options(options)
        name = f"{self.name} {options}"
        try:
            key = _key(name, fixed, tree, shapes)
        except Unnamed:
            return compiled
        place = _cache.get(key)
        if place is not None:
            executable = _read(place.decode(), tree)
            if executable is not None:
                return executable
        lowered = compiled.lower(*arguments)
        # Where the source alone has changed, and not what is computed, it is there too.
        place = _place(lowered, name, shapes)
        executable = _read(place, tree)
        if executable is None:
            with apart_from_cache():
                executable = lowered.compile()
            try:
                _cache.put(place, _serialized(executable))
            except Exception:  # Some cannot be kept, such as programs that call back.
                return executable
        _cache.put(key, place.encode())
        return executable


def _read(place: str, tree: Any) -> Callable[..., Any] | None:
    """The executable that is kept at a place, of arguments `tree`; None where none can be used."""
    content = _cache.get(place) if _cache else None
    if content is None:
        return None
    # Of another build of XLA, perhaps.
    with contextlib.suppress(Exception):
        return _deserialized(content, tree)
    return None


def kept_json(name: str, fixed: Any, compute: Callable[[], Any]) -> Any:
    """`compute()`, which follows from `fixed` alone and is data for JSON; kept as programs are."""
    if _cache is None:
        return compute()
    try:
        key = _key(name, fixed)
    except Unnamed:
        return compute()
    content = _cache.get(key)
    if content is not None:
        return json.loads(content)
    value = compute()
    _cache.put(key, json.dumps(value).encode())
    return value


def _is_array(leaf: Any) -> bool:
    """Whether a leaf has a shape and a type of numbers, and is no trace."""
    return isinstance(leaf, np.ndarray | np.generic) or (
        isinstance(leaf, jax.Array) and not isinstance(leaf, Tracer)
    )


def _shape_of(leaf: Any) -> tuple[Any, ...]:
    return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)


def _key(name: str, fixed: Any, tree: Any = None, shapes: Any = ()) -> str:
    """Digest of all that a program follows from.

    Raises:
        Unnamed: where a part has no name that tells it from others.
    """
    # A component of a plugin has no name.
    components = spelled(additions())
    parts = (name, spelled(fixed), components, str(tree), str(shapes))
    return _digest(parts, _source(), _settings(), _machine())


def _place(lowered: Any, name: str, shapes: Any) -> str:
    """Digest of a lowered program and of all that its executable follows from.

    An argument that the program does not use is not in its text, but the executable
    asks for its shape.
    """
    trees = str(lowered.in_tree), str(lowered.out_tree), str(shapes)
    return _digest(name, lowered.as_text(), trees, _settings(), _machine())


def _digest(*parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _settings() -> tuple[str, ...]:
    """JAX's settings, of this thread and of the process, and those of XLA."""
    context = []
    for setting in jax_config.trace_context():
        # Of names of axes JAX's text is an address.
        context.append(getattr(setting, "axis_sizes", setting))
    values = sorted(jax.config.values.items())
    variables = [(name, os.environ.get(name)) for name in VARIABLES]
    return repr(context), repr(values), repr(variables)


@functools.cache
def _machine() -> tuple[str, ...]:
    """Versions and the processor.

    Raises:
        Unnamed: for another device than one CPU.
    """
    devices = jax.devices()
    if len(devices) != 1 or devices[0].platform != "cpu":
        raise Unnamed
    versions = [f"{name} {importlib.metadata.version(name)}" for name in VERSIONED]
    return (
        repr(versions),
        platform.python_version(),
        devices[0].client.platform_version,
        processor(),
        str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0),
    )


@functools.cache
def _source() -> str:
    """Digest of this project's source as it was imported.

    Raises:
        Unnamed: where a file has changed since this process began.
    """
    digest = hashlib.sha256()
    began = _process_began()
    for file in sorted(ROOT.glob(f"{PACKAGES}*/**/*")):
        if file.suffix not in SOURCES:
            continue
        if file.stat().st_mtime > began:
            raise Unnamed
        content = file.read_bytes()
        digest.update(f"{file.relative_to(ROOT)} {len(content)} ".encode())
        digest.update(content)
    return digest.hexdigest()


def _process_began() -> float:
    """When this process began, in seconds as `time.time`; on Linux alone not too late."""
    try:
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        since_boot = int(fields[19]) / os.sysconf("SC_CLK_TCK")
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - since_boot
    except (OSError, AttributeError, IndexError, ValueError):
        return _IMPORTED
    return time.time() - age


def processor() -> str:
    """The processor and its instructions, as far as the system tells them."""
    words = [platform.machine(), platform.processor()]
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = ("model name", "flags", "Features")
        lines = info.read_text().splitlines()
        words += dict.fromkeys(line for line in lines if line.startswith(names))
    return " ".join(words)


def spelled(value: Any) -> str:
    """A value in words that tell it from others, the same in every process.

    Raises:
        Unnamed: for what has no such words, such as a function of a plugin.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    if isinstance(value, tuple | list):
        return f"({','.join(map(spelled, value))})"
    if isinstance(value, frozenset):
        return f"{{{','.join(sorted(map(spelled, value)))}}}"
    if isinstance(value, Mapping):
        return spelled([*value.items()])
    if isinstance(value, functools.partial):
        return f"partial{spelled((value.func, value.args, value.keywords))}"
    if isinstance(value, types.FunctionType | type | Program):
        return _qualified(value)
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        fields = [(name, getattr(value, name)) for name in names]
        return spelled(type(value)) + spelled(fields)
    raise Unnamed


def _qualified(value: Any) -> str:
    """Module and name of one of this project's functions or classes."""
    package = value.__module__.split(".")[0]
    file = getattr(sys.modules.get(package), "__file__", None)
    if not package.startswith(PACKAGES) or file is None or "<" in value.__qualname__:
        raise Unnamed
    if Path(file).resolve().parents[1] != ROOT:
        raise Unnamed  # Another package's function: its source is not in the key.
    return f"{value.__module__}.{value.__qualname__}"


def _serialized(compiled: Any) -> bytes:
    executable, _, out_tree = serialize_executable.serialize(compiled)
    return pickle.dumps((executable, out_tree))


def _deserialized(content: bytes, tree: Any) -> Callable[..., Any]:
    """The executable of arguments `tree`.

    As `serialize_executable.deserialize_and_load`, but it reads data only.
    """
    backend = jax.devices()[0].client
    executable, out_tree = _Data(io.BytesIO(content)).load()
    unloaded, arguments, no_kwargs = _Executable(io.BytesIO(executable), backend).load()
    # The arguments as `jax.jit` has them: positional ones, and none by name.
    positional = tuple(jax.tree.unflatten(tree, arguments))
    in_tree = jax.tree.structure((positional, {}))
    information = jax.tree.unflatten(in_tree, arguments)
    return jax.stages.Compiled(
        unloaded.load(), [], information, out_tree, no_kwargs=no_kwargs
    )


def _member(kind: Any, name: str) -> Any:
    """A member of an enumeration, which Python before 3.11.4 pickles by `getattr`."""
    if isinstance(kind, enum.EnumType):
        return kind[name]
    raise pickle.UnpicklingError(f"getattr of {kind!r}")


class _OnlyData:
    """Reads names of JAX's classes and of nodes of trees; calls nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """What a pickle may name.

        Raises:
            UnpicklingError: for everything else.
        """
        if (module, name) == ("builtins", "getattr"):
            return _member
        of_jax = module == "jax" or module.startswith(JAX_MODULES)
        if not (of_jax or module.startswith(NODES) or module == "numpy"):
            raise pickle.UnpicklingError(f"{module}.{name}")
        value = super().find_class(module, name)  # pyright: ignore[reportAttributeAccessIssue]
        if of_jax and name in (*UNPICKLERS, *RANDOM, *REGISTRIES):
            return value
        # What a module has imported from elsewhere is not its own.
        owner = getattr(value, "__module__", "").split(".")[0]
        allowed = isinstance(value, type) and owner == module.split(".")[0]
        if module == "numpy":
            allowed = value is np.dtype
        elif not of_jax:
            # A node of a tree is made of its leaves, and does nothing.
            allowed = allowed and issubclass(value, tuple | Scene)
        if not allowed:
            raise pickle.UnpicklingError(f"{module}.{name}")
        return value


class _Data(_OnlyData, pickle.Unpickler):
    pass


if hasattr(serialize_executable, "_JaxPjrtUnpickler"):

    class _Executable(_OnlyData, serialize_executable._JaxPjrtUnpickler):
        pass


# Products of matrices with all bits of float32, on every device.
#
# By default a GPU or TPU multiplies float32 matrices in fewer bits: TF32 keeps 10 of 23.
# That moves forecasts by millimetres, and would end the agreement with torch.

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def full_precision(
    function: Callable[Arguments, Result],
) -> Callable[Arguments, Result]:
    """Make a function whose products of matrices keep all bits.

    Whoever sets `JAX_DEFAULT_MATMUL_PRECISION` or `jax.default_matmul_precision` gets
    what they set.
    """

    @functools.wraps(function)
    def with_all_bits(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        if jax.default_matmul_precision.value is not None:
            return function(*args, **kwargs)
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return with_all_bits
