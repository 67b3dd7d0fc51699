"""Reading ETH/UCY's test recordings and cutting windows of 8 + 12 steps: ours, the original's."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.timing import OURS, alternate, rows


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    data = options.need("data")
    contestants = {OURS: functools.partial(ours, data)}
    if options.reference:
        contestants["original"] = functools.partial(original, data, options.reference)
    timings = alternate(contestants, options.repeats)
    counts = {who: timing.result for who, timing in timings.items()}
    if len(set(counts.values())) > 1:
        raise AssertionError(f"not the same windows: {counts}")
    case = f"{counts[OURS]} agent windows"
    return {"title": "reading and windowing", "rows": rows(case, timings)}


def ours(data: Path) -> Callable[[], int]:
    """Windows of people, counted."""
    from neurosym_jax.data.readers.columns import Text
    from neurosym_jax.data.recordings import SCENES, split_files
    from neurosym_jax.data.tables import AS_IT_SAYS
    from neurosym_jax.data.tracks import PERIOD
    from neurosym_jax.data.windows import cut_windows, make_batches

    def run() -> int:
        files = [split_files(data, scene, "test") for scene in SCENES]
        tracks = []
        for paths in files:
            tracks.append([Text().read(path, AS_IT_SAYS, PERIOD)[0] for path in paths])
        windows = [cut_windows(recordings, 8, 12) for recordings in tracks]
        for part in windows:
            make_batches(part)
        return sum(part.agents for part in windows)

    return run


def original(data: Path, reference: Path) -> Callable[[], int]:
    """The same of the original's."""
    from benchmarks.original import folder_of, load_script
    from neurosym_jax.data.recordings import SCENES

    load_script(reference, "evaluate_model")
    from sgan.data.trajectories import (  # pyright: ignore[reportMissingImports]
        TrajectoryDataset,
    )

    def run() -> int:
        count = 0
        for names in SCENES.values():
            with folder_of([data / "all" / f"{name}.txt" for name in names]) as folder:
                dataset = TrajectoryDataset(folder, obs_len=8, pred_len=12, delim="tab")
            count += len(dataset.obs_traj)
        return count

    return run
