"""Run what the pages show: `python -P tests/pages.py` in an empty folder, with a wheel installed.

Sybil finds the blocks. Each page's Python runs in order with the names of `prepare`,
which stand for a reader's own; commands run in this process, trainings for two steps.
What a page shows to be printed is compared. What needs more than the package is left
out by `LACK` and `SKIPPED`.
"""

import contextlib
import io
import re
import shlex
import shutil
import sys
import textwrap
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from sybil import Document, Example, Region, Sybil
from sybil.parsers.markdown import CodeBlockParser

import neurosym_jax as nj
from neurosym_jax.__main__ import main
from neurosym_jax.data.tables import FORMATS
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.models.forecaster import FORECASTERS
from neurosym_jax.symbolic.weighting import WEIGHTINGS

ROOT = Path(__file__).resolve().parents[1]
TABLES: tuple[dict[str, Any], ...] = (FORMATS, METRICS, FORECASTERS, WEIGHTINGS)
LACK = re.compile(
    r"\b[A-Z]{2,}[A-Z_0-9]*\b|eth-ucy|download|sgan-|my_checkpoint|recording\.bag|--jobs|\bros[12]\b"
    r"|tests/golden|examples/|recipe\.yaml|recommended model\.|evaluate$|train *$|train --set"
    r"|--family neurosym|--init|report |replay "
)
"""Words of commands that need data, a bag, a robot or a clone, or that take half a minute."""
SKIPPED = {
    "from_pretrained": "needs the Hub",
    "nj.train(": "trains a whole recipe",
    "nj.interop.compare": "needs torch's module",
    "load_torch_training": "run by tests/interop/test_torch_training.py",
    "InferenceSession": "run by tests/interop/test_onnx.py",
    "jax.export": "run by tests/interop/test_export.py",
    "OnnxModel(": "run by tests/robot/online/test_onnx.py",
    "Dashboard(": "serves a page",
    "eth-ucy": "needs ETH/UCY, as what follows it",
    "nj.plotting": "run by studies.gallery",
}
"""Blocks by words of theirs, and why they are left out."""
SHOWN = re.compile(
    r"(?:```)?\n+(?:It |which )?prints?\b[^\n]*\n\n((?: {4}[^\n]*\n|\n(?= {4}))+)"
)
NUMBER = re.compile(r"\d*\.\d+")


def prepare() -> dict[str, Any]:
    """Write a reader's files into this folder; the names that blocks take for granted."""
    (tracks,) = nj.data.open_source(None, None).recordings("cross-path", "test")[:1]
    tracks = tracks.take(tracks.stamp < 80)
    place = dict(zip("xy", tracks.position.T.round(3)))
    frame = pl.DataFrame({"time": tracks.stamp.round(1), "person": tracks.id} | place)
    frame.write_csv("my_tracks.csv")
    frame.write_csv("tracks.txt", separator="\t")
    metres = pl.col("x", "y")
    frame.with_columns(metres * 1000).write_csv("mine.csv")
    frame.select(pl.col("time") * 25, "person", metres).cast({"time": int}).write_csv(
        "my_tracks.txt", separator=" ", include_header=False
    )
    windows = nj.windows_from("my_tracks.csv", 8, 8)
    still = np.repeat(windows.position[None, :, 7:8], 8, axis=2)
    stamp = np.repeat(np.asarray(windows.stamp), windows.sizes)
    np.savez("mine.npz", samples=still, ids=windows.agent, frames=stamp)
    scene = windows.position[windows.rows(np.array([0]))].astype(np.float32)
    return {
        "frame": frame.rename({"person": "who"}).with_columns(metres * 100),
        "model": nj.load_model("recommended"),
        "observed": scene[:, :8],
        "positions": scene[:, :8],
        "valid": np.ones(len(scene), bool),
        "frames": [(0.4 * at, np.arange(len(scene)), scene[:, at]) for at in range(10)],
        "one": "sgan_zara1_8",
        "other": "neurosym_zara1_8",
        "k": scene[0, :8],
        "l": scene[1, :8],
    }


def commands(document: Document) -> Iterator[Region]:
    """Lines of `neurosym` in indented blocks; a line that ends in a backslash goes on."""
    for match in re.finditer(r"(?m)^ {4}(neurosym (?:.*\\\n)*.*)$", document.text):
        line = re.sub(r"\s+#.*|\s+>.*", "", match[1].replace("\\\n", " "))
        yield Region(match.start(), match.end(), line, run_command)


def run_command(example: Example) -> None:
    """Run a command in this process, if it needs no more than `prepare` has written."""
    command, shown = example.parsed, SHOWN.match(example.document.text, example.end)
    done = example.namespace["done"]
    if (LACK.search(command) and not shown) or command in done:
        return
    words = shlex.split(command)[1:]
    if words[0] in ("train", "sweep", "compare-weightings"):
        short = re.sub(r" --steps \d+|$", " --steps 2", command, count=1)
        words = shlex.split(short)[1:]
    if words[0] == "compare-weightings":
        words += ["--set", "batch_scenes=2", "best_k=1", "max_agents=4"]
    printed, status = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        try:
            main(words)
        except SystemExit as ended:
            status = ended.code
    assert not status, f"{command}: exit status {status}"
    if shown:
        compare(shown[1], printed.getvalue())
    done.append(command)


def run_block(example: Example) -> None:
    """Run Python; a file that commands name is written."""
    code = str(example.parsed)
    if any(words in code for words in SKIPPED):
        return
    file = re.match(r"# ([\w/]+\.py)", code) or re.search(r"class (Damped)\b", code)
    tables = [dict(table) for table in TABLES]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "block", "exec"), example.namespace)
    if file:
        Path(file[1].lower().removesuffix(".py") + ".py").write_text(code)
        restore(tables)
    shown = SHOWN.match(example.document.text, example.end)
    if shown:
        compare(shown[1], printed.getvalue())
    example.namespace["done"].append(code)


def compare(shown: str, printed: str) -> None:
    """Every line that is shown was printed, but that numbers may differ by a tenth."""
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    texts = [NUMBER.sub("#", line) for line in lines]
    for line in filter(None, (" ".join(line.split()) for line in shown.splitlines())):
        assert NUMBER.sub("#", line) in texts, f"not printed: {line}\n{printed}"
        alike = [n for n, text in enumerate(texts) if text == NUMBER.sub("#", line)]
        expected = numbers_in(line)
        values = [numbers_in(lines[n]) for n in alike]
        close = [np.allclose(numbers, expected, rtol=0.1) for numbers in values]
        assert any(close), printed


def numbers_in(line: str) -> list[float]:
    """Those with a point."""
    return [float(number) for number in NUMBER.findall(line)]


def restore(contents: list[dict[str, Any]]) -> None:
    """Forget what was registered since the tables had `contents`."""
    for table, content in zip(TABLES, contents):
        for name in table.keys() - content.keys():
            del table[name]


def run(pages: list[Path]) -> int:
    """Run all pages; print what failed and how much ran; the exit status."""
    names, failures, done = prepare(), 0, list[str]()
    batch = {
        name: np.repeat(names["observed"][None], 4, axis=0)
        for name in ("observed", "future")
    }
    sybil = Sybil([CodeBlockParser("python", run_block), commands])
    for page in pages:
        document = sybil.parse(page)
        document.namespace |= names | {"done": done, "__name__": page.stem}
        document.namespace |= batch if page.stem == "extend" else {}
        tables = [dict(table) for table in TABLES]
        for example in document.examples():
            try:
                example.evaluate()
            except Exception:
                failures += 1
                print(
                    f"{page.name}:{example.line}: {textwrap.indent(traceback.format_exc(), ' ')}"
                )
        restore(tables)
    print(
        f"ran {len(done)} blocks and commands of {len(pages)} pages, {failures} failed"
    )
    return min(failures, 1)


if __name__ == "__main__":
    shutil.copytree(ROOT / "examples", "examples")
    sys.exit(run([Path(name) for name in sys.argv[1:]]))
