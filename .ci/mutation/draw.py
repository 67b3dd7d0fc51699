"""Draw mutants of a session of Cosmic Ray: `draw.py SESSION COUNT SEED`, so many of each package.

A place has one mutant at most, however many operators fit it. `|` between types is no
place: a mutant of an annotation ends the import.
"""

import random
import sqlite3
import sys
from pathlib import Path

session, count, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
with sqlite3.connect(session) as database:
    rows = database.execute(
        "select job_id, module_path, operator_name, start_pos_row, start_pos_col "
        "from mutation_specs order by module_path, start_pos_row, start_pos_col, operator_name"
    )
    draw, packages = random.Random(seed), {}
    for job, module, operator, *place in rows:
        if "BitOr" not in operator:
            places = packages.setdefault(Path(module).parts[1], {})
            places.setdefault((module, *place), []).append(job)
    kept = [
        draw.choice(places[place])
        for places in packages.values()
        for place in draw.sample(sorted(places), min(count, len(places)))
    ]
    marks = ",".join("?" * len(kept))
    for table in ("mutation_specs", "work_items"):
        database.execute(f"delete from {table} where job_id not in ({marks})", kept)
