"""Figures of docs/reliability.md: small files that ask for much, and damage to what is read.

    python -m studies.reliability

It takes minutes. Every bit of a shipped model's `config.json`, bits of its parameters
and of its compiled programs drawn with a seed, and bytes of bags are changed. Silent is
what reads differently without a warning.
"""

import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import predict
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import shipped_models
from neurosym_jax.runtime.compiled import SealedCache, keep_programs
from neurosym_jax.simulation.scenarios import simulate
from neurosym_robot.ros.bags import BagWriter, read_people
from neurosym_robot.ros.definitions import PEOPLE_TOPICS, shared_typestore
from neurosym_robot.ros.messages import make_people
from neurosym_robot.tracking.following import frames_of_tracks

__all__ = ["BAGS", "bag_of_blanks", "main"]

BAGS = ("bag LZ4", "bag BZ2", "mcap STORAGE", "db3 MESSAGE", "db3 FILE")
"""Kinds of bags, and what in them is compressed."""
SIZE = 600_000_000  # bytes in a small file, once it is decompressed
FLIPS, PROGRAM_FLIPS, MUTATIONS = 1000, 500, 300
COLUMNS = (
    "refused",
    "read as before",
    "other values",
    "frames lost, said",
    "frames lost, silent",
)

TABLE, MODEL = "nj.data.read_any(path)", "nj.load_model(path)"
MAP = (
    "from neurosym_robot.dashboard.moments import read_floor_map; read_floor_map(path)"
)
LAUGHS = "a0: &a0 [x]\n" + "".join(
    f"a{n}: &a{n} [{f'*a{n - 1},' * 10}]\n" for n in range(1, 10)
)
TEXTS = {
    # what: file, content, code that reads it
    "table of 8 million columns": (
        "a.csv",
        "t,id,x,y" + ",c" * 8_000_000 + "\n1\n",
        TABLE,
    ),
    "JSON, 100,000 deep": ("deep.ndjson", '{"track": {"f": ' + "[" * 100_000, TABLE),
    "YAML of a map, aliases of aliases": ("a.yaml", LAUGHS, MAP),
}
READING = """
import json, resource, sys, time, warnings
from pathlib import Path
import neurosym_jax as nj
def peak():
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
warnings.simplefilter("ignore")
nj.load_model, nj.data.read_any
path, before, since, said = Path(sys.argv[1]), peak(), time.perf_counter(), "read"
try:
    exec(sys.argv[2])
except nj.InputError as error:
    said = str(error).removeprefix(f"{path}: ")[:70]
took = max(peak() - before, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
print(json.dumps([f"{took / 1e3:.0f}", f"{time.perf_counter() - since:.1f}", said]))
"""


def main() -> None:
    """Print the four tables."""
    with tempfile.TemporaryDirectory() as folder:
        print("| file | bytes | MB | seconds | |\n|---|---:|---:|---:|---|")
        for name, path, code in _bombs(Path(folder)):
            size = sum(f.stat().st_size for f in (path, *path.glob("*")) if f.is_file())
            command = [sys.executable, "-c", READING, str(path), code]
            took = json.loads(
                subprocess.check_output(command, text=True).splitlines()[-1]
            )
            print(f"| {name} | {size} | {' | '.join(took)} |")
        print("\n| damage | cases | refused | loaded |\n|---|---|---|---|")
        for name, counts in _models(Path(folder)):
            print(
                f"| {name} | {counts.total()} | {counts['refused']} | {counts['loaded']} |"
            )
        print("\n| damage | cases | same forecast | healed |\n|---|---:|---:|---:|")
        same, healed = _programs(Path(folder))
        print(
            f"| compiled programs, random bits | {PROGRAM_FLIPS} | {same} | {healed} |"
        )
        print(
            f"\n| bag | cases | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 2)}"
        )
        for kind in ("bag", "db3", "mcap"):
            counts = _changed_bytes(Path(folder), kind)
            cells = " | ".join(str(counts[name]) for name in COLUMNS)
            print(f"| {kind} | {counts.total()} | {cells} |")


def bag_of_blanks(path: Path, kind: str, size: int = SIZE) -> Path:
    """A bag of one of `BAGS` with a text of `size` blanks."""
    from rosbags import rosbag1, rosbag2

    ending, compressed = kind.split()
    ros1 = ending == "bag"
    store = shared_typestore(1 if ros1 else 2)
    text = store.types["std_msgs/msg/String"](data=" " * size)
    if ros1:
        writer = rosbag1.Writer(path := path.with_suffix(".bag"))
        writer.set_compression(rosbag1.Writer.CompressionFormat[compressed])
    else:
        plugin = rosbag2.StoragePlugin["MCAP" if ending == "mcap" else "SQLITE3"]
        writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
        writer.set_compression(
            rosbag2.CompressionMode[compressed], rosbag2.CompressionFormat.ZSTD
        )
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        connection = writer.add_connection("/text", text.__msgtype__, typestore=store)
        writer.write(connection, 10**9, serialize(text, text.__msgtype__))
    return path


def _bombs(folder: Path) -> Iterator[tuple[str, Path, str]]:
    """What a small file is, its path, and the code that reads it."""
    for kind in BAGS:
        yield kind, bag_of_blanks(folder / kind.replace(" ", "_"), kind), TABLE
    for name, (file, content, code) in TEXTS.items():
        (folder / file).write_text(content)
        yield name, folder / file, code
    with zipfile.ZipFile(path := folder / "a.pt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data.pkl", bytes(SIZE))
    yield "zip of torch", path, MODEL


def _models(folder: Path) -> Iterator[tuple[str, Counter]]:
    """What is damaged, and how often it was refused and loaded."""
    model = folder / "model"
    shutil.copytree(
        next(path for path in shipped_models() if path.name == "sgan_zara1_8"), model
    )
    rng = np.random.default_rng(0)
    for name, flips in (("config.json", None), ("params.safetensors", FLIPS)):
        file = model / name
        bits = 8 * file.stat().st_size
        chosen = (
            range(bits) if flips is None else rng.choice(bits, flips, replace=False)
        )
        counts: Counter[str] = Counter()
        for bit in map(int, chosen):
            with _changed(file, {bit // 8: 1 << bit % 8}):
                try:
                    load_model(model)
                    counts["loaded"] += 1
                except InputError:
                    counts["refused"] += 1
        bits_drawn = "each of its bits" if flips is None else "bits drawn from all"
        yield f"`{name}`, {bits_drawn}", counts


def _programs(folder: Path) -> tuple[int, int]:
    """Forecasts with the same bits from programs of which one is damaged, and programs mended."""
    keep_programs(folder / "programs")
    model = load_model(folder / "model")
    steps = np.arange(float(model.config.obs_len))[:, None] * [0.4, 0.1]
    observed = np.stack([steps, 4 - steps])
    expected, same, healed = predict(model, observed, samples=3).tobytes(), 0, 0
    files, rng = sorted((folder / "programs").iterdir()), np.random.default_rng(0)
    for _ in range(PROGRAM_FLIPS):
        file = files[rng.integers(len(files))]
        content = bytearray(file.read_bytes())
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        file.write_bytes(content)
        jax.clear_caches()
        same += predict(model, observed, samples=3).tobytes() == expected
        healed += SealedCache(folder / "programs").get(file.stem) is not None
    return same, healed


def _content(path: Path) -> list[tuple[float, list, list]]:
    return [(f.stamp, f.ids.tolist(), f.xy.tolist()) for f in read_people(path)]


def _changed_bytes(folder: Path, kind: str) -> Counter:
    """How often a bag of 60 frames was read in which way, with one to three bytes changed."""
    with BagWriter(folder / kind / f"run.{kind}") as bag:
        for frame in frames_of_tracks(simulate("cross-path", 1, 6.0, people=3)):
            frame = frame._replace(stamp=frame.stamp + 1.7e9)
            bag.write(PEOPLE_TOPICS[0], frame.stamp, make_people(bag.new, frame))
    path = bag.path
    files = [path] if path.is_file() else sorted(path.iterdir())
    intact, counts = _content(path), Counter()
    for seed in range(MUTATIONS):
        rng = np.random.default_rng(seed)
        file = files[0] if seed % 10 == 0 else files[-1]  # metadata.yaml now and then
        size = file.stat().st_size
        damage = {
            int(rng.integers(size)): int(rng.integers(1, 256))
            for _ in range(1 + seed % 3)
        }
        with _changed(file, damage), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                got = _content(path)
            except InputError:
                counts["refused"] += 1
                continue
        if len(got) != len(intact):
            counts["frames lost, said" if caught else "frames lost, silent"] += 1
        else:
            counts["read as before" if got == intact else "other values"] += 1
    return counts


@contextlib.contextmanager
def _changed(file: Path, damage: dict[int, int]) -> Iterator[None]:
    """A context in which bytes of a file are others."""
    content = file.read_bytes()
    broken = bytearray(content)
    for place, by in damage.items():
        broken[place] ^= by
    file.write_bytes(broken)
    yield
    file.write_bytes(content)


if __name__ == "__main__":
    main()
