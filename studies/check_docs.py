"""Run the commands that README and docs/ name, and say what each ends with.

    python -m studies.check_docs [SECONDS]

A command that is still at work after SECONDS (60) is stopped and counts as running. Those that need
what is not in a clone (data, a bag, a robot, torch) are listed with what they lack. The exit status
is 1 where one of the others fails. Everything happens in a folder that is removed.
"""

import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

__all__ = ["commands", "lacking", "plain"]

ROOT = Path(__file__).resolve().parents[1]
STARTS = ("neurosym ", "python -m neurosym_jax ", "python evaluate.py", "python train.py")
INLINE = re.compile(
    r"`((?:neurosym|python -m neurosym_jax|python evaluate\.py|python train\.py) [^`]*)`"
)
LACK = re.compile(
    r"\b[A-Z]{2,}[A-Z_0-9]*\b|\.\.\.|eth-ucy|\bdownload\b|sgan-|my_checkpoint\.pt|recording\.bag"
    r"|runs/|\bM\.pt|\bros[12]\b|\bcases\b|\bconvert\b|\breport\b|--torch-module|parity$|--dashboard"
)
"""What stands for something that is not in a clone."""


def commands() -> Iterator[tuple[Path, str]]:
    """Each page and each command that it names, in a line of its own or in a sentence."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        lines = [line.strip() for line in text.splitlines() if line.startswith("    ")]
        own_lines = [
            line for line in lines if line.startswith(STARTS) or line == "neurosym evaluate"
        ]
        for command in dict.fromkeys([*own_lines, *INLINE.findall(text)]):
            yield page.relative_to(ROOT), plain(command)


def plain(command: str) -> str:
    """`command` as `neurosym COMMAND ...`, without comment, redirection and brackets."""
    command = re.sub(r"\s#.*|\s>.*|&&.*", "", " ".join(command.split()))
    command = re.sub(r"[\[\]]|\|\S+", "", command)  # Of alternatives the first.
    command = command.replace("python -m neurosym_jax", "neurosym")
    return re.sub(r"python (evaluate|train)\.py", r"neurosym \1", command).strip()


def lacking(command: str) -> str:
    """What a clone lacks to run `command`; nothing where it can be run."""
    lack = LACK.search(command)
    return lack[0] if lack else ""


def _prepare(folder: Path) -> None:
    """The files that stand for a reader's own, and those that a clone has."""
    for name in ("checkpoints", "examples"):
        (folder / name).symlink_to(ROOT / name)
    from neurosym_jax.data.sources import Synthetic

    tracks = Synthetic().recordings("cross-path", "test")[0]
    frames = np.rint(tracks.stamp / 0.4).astype(int)
    rows = list(zip(frames, tracks.id, *tracks.position.T))
    text = "".join(f"{frame} {person} {x:.3f} {y:.3f}\n" for frame, person, x, y in rows)
    for name in ("my_tracks.txt", "mine.txt"):
        (folder / name).write_text(text)
    table = "".join(f"{0.4 * frame:.1f},{person},{x:.3f},{y:.3f}\n" for frame, person, x, y in rows)
    (folder / "my_tracks.csv").write_text("time,person,x,y\n" + table)
    pages = (ROOT / "docs" / "weightings.md").read_text(encoding="utf-8")
    (folder / "nearness.py").write_text(pages.split("```python\n")[1].split("```")[0])


def main(seconds: float = 60) -> int:
    """Run all that can be run; the number of those that failed, at most 1."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        _prepare(Path(folder))
        for command in dict.fromkeys(command for _, command in commands()):
            if lacks := lacking(command):
                print(f"lacks {lacks:12} {command}")
                continue
            words = [sys.executable, "-m", "neurosym_jax", *shlex.split(command)[1:]]
            env = {**os.environ, "PYTHONPATH": str(ROOT)}
            try:
                done = subprocess.run(
                    words, cwd=folder, env=env, capture_output=True, text=True, timeout=seconds
                )
                status, message = str(done.returncode), done.stderr.strip().splitlines()[-1:]
            except subprocess.TimeoutExpired:
                status, message = "runs", []
            print(f"{status:18} {command}")
            if status not in ("0", "runs"):
                failed = 1
                print(*message, sep="\n")
    return failed


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:])))
