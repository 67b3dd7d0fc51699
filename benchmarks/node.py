"""A node with ONNX Runtime beside one with JAX: seconds of CPU to start, memory, time of a frame.

Each runs a `Predictor` of `recommended` in a process of its own, on one thread, and is
fed 5, 20 and 60 people in squares of one person for 4 square metres, ten frames a
second. A frame is a forecast with its draws and regions. Rounds alternate.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.timing import OURS, row

ONNX = "ONNX Runtime"
PEOPLE = (5, 20, 60)
NODE = """
import json, sys, time
import numpy as np
from neurosym_robot.online.predictor import Predictor, load_models
from pathlib import Path

people = json.loads(sys.argv[2])
models = load_models([Path(sys.argv[1])])
predictor = Predictor(models, max_people=max(people), compile="needed", min_seen=0.0)

def frames(count, number, begin):
    rng, side = np.random.default_rng(count), 2 * count**0.5
    start, speed = rng.uniform(0, side, (count, 2)), rng.normal(0, 0.8, (count, 2))
    for n in range(number):
        # They turn back at the walls.
        xy = side - np.abs((start + speed * n / 10) % (2 * side) - side)
        yield begin + n / 10, np.arange(count), xy

def push(frame):
    (result,) = predictor.push(*frame).models.values()
    return result.regions

for number, frame in enumerate(frames(people[0], 2, 0.0)):
    push(frame)
facts = {"start": time.process_time(), "milliseconds": {}}
for number, count in enumerate(people):
    spent = []
    for frame in frames(count, 80, 100.0 * (number + 1)):
        begin = time.perf_counter()
        push(frame)
        spent.append(time.perf_counter() - begin)
    facts["milliseconds"][count] = 1e3 * float(np.median(spent[40:]))
# Not by getrusage, which counts the parent's memory before this process was loaded.
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
facts["memory"] = int(status["VmHWM"].split()[0]) / 1024
print(json.dumps(facts))
"""


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.interop.export import export_onnx
    from neurosym_jax.models.disk import load_model

    facts: dict[str, list[dict[str, Any]]] = {OURS: [], ONNX: []}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "recommended.onnx"
        file.write_bytes(export_onnx(load_model("recommended"), points=True))
        for _ in range(options.repeats):
            facts[OURS].append(_node("recommended"))
            facts[ONNX].append(_node(str(file)))
    table = []
    for name, rounds in facts.items():
        begun = [each["start"] for each in rounds]
        memory = [each["memory"] for each in rounds]
        table.append(row("CPU to the first draws", name, begun, "s"))
        table.append(row("memory", name, memory, "MB"))
        for people in map(str, PEOPLE):
            spent = [each["milliseconds"][people] for each in rounds]
            table.append(row(f"a frame of {people} people", name, spent, "ms"))
    return {"title": "a node with ONNX Runtime beside JAX", "rows": table}


def _node(model: str) -> dict[str, Any]:
    """What a process measured of itself."""
    environment = os.environ | {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
    words = [sys.executable, "-c", NODE, model, json.dumps(PEOPLE)]
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])
