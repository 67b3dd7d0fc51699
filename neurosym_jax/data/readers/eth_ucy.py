"""The leave-one-out splits of ETH/UCY.

As SGAN arranges it, the folder has `all/` (whole recordings, for testing), `train/` and
`val/`.
"""

from pathlib import Path

from neurosym_jax.errors import InputError

__all__ = ["SCENES", "split_files"]

SCENES = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""The recordings that each of the benchmark's five data sets tests on."""


def split_files(folder: Path, scene: str | None, split: str) -> list[Path]:
    """Files of one leave-one-out split: `test` has the whole recordings of the data set
    `scene`, `train` and `val` have parts of all others (None leaves out none).

    Raises:
        InputError: for an unknown data set or missing files.
    """
    if scene is not None and scene not in SCENES:
        raise InputError(f"unknown data set {scene!r}: ETH/UCY has {', '.join(SCENES)}")
    own = SCENES[scene] if scene else ()
    paths = [folder / "all" / f"{name}.txt" for name in own]
    if split != "test":
        held_out = {f"{name}_{split}" for name in own}
        files = sorted((folder / split).glob("*.txt"))
        paths = [path for path in files if path.stem not in held_out]
    missing = [
        path for path in paths or [folder / split / "*.txt"] if not path.is_file()
    ]
    if missing:
        raise InputError(f"{missing[0]}: missing, and data set {scene} needs it")
    return paths
