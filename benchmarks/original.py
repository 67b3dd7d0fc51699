"""The original SGAN code out of a checkout, kept on the CPU: the opponent of `--reference`."""

import contextlib
import importlib.util
import sys
import tempfile
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError


class Arguments(dict):
    """A dictionary whose items are attributes: what the original takes from `attrdict`."""

    __getattr__ = dict.__getitem__


def load_script(reference: Path, name: str) -> Any:
    """`scripts/NAME.py` of the checkout as a module; its own parser is not run.

    Raises:
        InputError: for a folder that is no checkout of SGAN.
    """
    path = reference / "scripts" / f"{name}.py"
    if not path.is_file():
        raise InputError(f"{reference}: no checkout of SGAN: it has no scripts/{name}.py")
    import torch

    # It calls .cuda() unasked, and views tensors that today's torch wants contiguous for that.
    torch.Tensor.cuda = lambda self, *args, **kwargs: self.contiguous()
    torch.nn.Module.cuda = lambda self, *args, **kwargs: self
    # Its own dependency has not been installable since Python 3.10.
    sys.modules.setdefault("attrdict", types.SimpleNamespace(AttrDict=Arguments))  # pyright: ignore
    if str(reference) not in sys.path:
        sys.path.insert(0, str(reference))
    spec = importlib.util.spec_from_file_location(f"sgan_{name}", path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


@contextlib.contextmanager
def folder_of(recordings: list[Path]) -> Iterator[str]:
    """A folder that holds these files and nothing else, as its loader wants them."""
    with tempfile.TemporaryDirectory() as folder:
        for path in recordings:
            (Path(folder) / path.name).symlink_to(path.resolve())
        yield folder
