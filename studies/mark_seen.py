"""Write fingerprints of their training windows into models that were trained without.

python -m studies.mark_seen ETH_UCY THOR MODEL ...

What a model was trained on follows from the data set that it leaves out. Recordings beyond ETH/UCY
that a `general` model saw are not marked.
"""

import sys
from pathlib import Path

from neurosym_jax.data.leakage import fingerprint
from neurosym_jax.data.sources import GENERAL, Source, Synthetic, open_source
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.forecasting.model_folder import load_model, mark_seen


def training_of(dataset: str | None, eth_ucy: Path, thor: Path) -> tuple[Source, list[str]]:
    """The source of a model's training data, and the data sets of which `train` was read."""
    if dataset in (None, Synthetic.name):
        return Synthetic(), list(Synthetic().scenes)
    for folder in (eth_ucy, thor):
        source = open_source(folder)
        if dataset in (*source.scenes, GENERAL):
            return source, [str(dataset)]
    raise SystemExit(f"{dataset}: in neither {eth_ucy} nor {thor}")


def main(eth_ucy: Path, thor: Path, folders: list[Path]) -> None:
    """Mark every model that is not marked."""
    for folder in folders:
        model = load_model(folder)
        if not model.seen:
            source, names = training_of(model.dataset, eth_ucy, thor)
            recordings = [tracks for name in names for tracks in source.recordings(name, "train")]
            config = model.config
            mark_seen(folder, fingerprint(cut_windows(recordings, config.obs_len, config.pred_len)))
            print(f"{folder.name}: {model.dataset}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [Path(name) for name in sys.argv[3:]])
