"""Reading ETH/UCY's test recordings and cutting windows of 8 + 12 steps: ours, the original's."""

from collections.abc import Callable
from typing import Any

from benchmarks.timing import OURS, alternate, rows


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.data.readers.eth_ucy import SCENES, split_files
    from neurosym_jax.data.readers.layouts import Text
    from neurosym_jax.data.reading import AS_IT_SAYS
    from neurosym_jax.data.tracks import PERIOD
    from neurosym_jax.data.windows import cut_windows, make_batches

    data, counts = options.need("data"), {}

    def ours() -> None:
        files = [split_files(data, scene, "test") for scene in SCENES]
        read = [[Text().read(path, AS_IT_SAYS, PERIOD)[0] for path in paths] for paths in files]
        windows = [cut_windows(tracks, 8, 12) for tracks in read]
        for part in windows:
            make_batches(part)
        counts[OURS] = sum(part.agents for part in windows)

    contestants: dict[str, Callable[[], object]] = {OURS: ours}
    if options.reference:
        from benchmarks.original import folder_of, load_script

        load_script(options.reference, "evaluate_model")
        from sgan.data.trajectories import (  # pyright: ignore[reportMissingImports]
            TrajectoryDataset,
        )

        def original() -> None:
            counts["original"] = 0
            for names in SCENES.values():
                with folder_of([data / "all" / f"{name}.txt" for name in names]) as folder:
                    dataset = TrajectoryDataset(folder, obs_len=8, pred_len=12, delim="tab")
                counts["original"] += len(dataset.obs_traj)

        contestants["original"] = original
    seconds = alternate(contestants, options.repeats)
    if len(set(counts.values())) > 1:
        raise AssertionError(f"not the same windows: {counts}")
    case = f"{counts[OURS]} agent windows"
    return {"title": "reading and windowing", "rows": rows(case, seconds)}
