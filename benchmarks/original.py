"""The original code out of checkouts, kept on the CPU: the opponents of `--reference`."""

import contextlib
import importlib.util
import sys
import tempfile
import types
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

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
        raise InputError(
            f"{reference}: no checkout of SGAN: it has no scripts/{name}.py"
        )
    import torch

    # It calls .cuda() unasked, and views tensors that today's torch wants contiguous
    # for that.
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


def load_labelling(
    reference: Path,
) -> Callable[[Iterable[Any]], tuple[np.ndarray, list]]:
    """NeuroSyM's own labelling of pairs of tracks [T, 2]: states [pairs, T-1, 4], and labels.

    The two lines of its loader are repeated here, for the loader does them while it
    reads files.

    Raises:
        InputError: for a folder that is no checkout of NeuroSyM.
    """
    scripts = (reference / "NeuroSyM-sgan" / "scripts").resolve()
    if not (scripts / "sgan" / "data" / "trajectories_informed.py").is_file():
        raise InputError(
            f"{reference}: no checkout of NeuroSyM: it has no NeuroSyM-sgan/scripts"
        )
    # Its package is called sgan too, and another checkout's may be imported already.
    another = {
        name: sys.modules.pop(name) for name in list(sys.modules) if _is_sgan(name)
    }
    path = [
        str(scripts),
        *(entry for entry in sys.path if not (Path(entry) / "sgan").is_dir()),
    ]
    with mock.patch.object(sys, "path", path):
        loader = importlib.import_module("sgan.data.trajectories_informed")
    for name in filter(_is_sgan, list(sys.modules)):
        del sys.modules[name]
    sys.modules.update(another)
    reader = object.__new__(loader.TrajectoryDataset)
    reader.labels_dir, reader.filename = "sgan/data/", "cnd_labels.txt"

    def label(
        pairs: Iterable[tuple[np.ndarray, np.ndarray]],
    ) -> tuple[np.ndarray, list]:
        states, labels = [], []
        # It opens a file of the working directory for every label.
        with warnings.catch_warnings(), contextlib.chdir(scripts):
            warnings.simplefilter(
                "ignore"
            )  # numpy's, of crossing two-dimensional vectors.
            for k, l in pairs:  # noqa: E741
                states.append(loader.qtcc1(k, l, qbits=4))
                labels.append([reader.labelme(state.tolist()) for state in states[-1]])
        return np.stack(states), labels

    return label


def _is_sgan(module: str) -> bool:
    return module.split(".")[0] == "sgan"
