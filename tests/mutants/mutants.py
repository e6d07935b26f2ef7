"""How many small faults do the fast tests find? `make mutants` tries a seeded sample of them and prints those that survive.

A fault (mutant) is one change of one operator, number, condition or statement: mutant.py, python_operators.py, c_operators.py. It is put
into a copy of the project, never into the project itself, and the fast tests of its area (areas.py) run until the first fails.

mutmut and cosmic-ray know Python alone and start the tests anew for each mutant: here half of what matters is C, or Python that writes
C, and importing CasADi, fmpy and pytest takes longer than most of the tests that find a fault.

Every result is a line of a file, so that an interrupted run goes on where it stopped; a line counts while the mutated file, its
text around the fault, is as it was.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from areas import AREAS, Area
from mutant import Mutant, mutants_of
from sandbox import BROKEN, KILLED, SURVIVED, TIMED_OUT, Sandbox

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "build" / "mutants"
PER_AREA = 20  # 16 areas: 320
PATIENCE = 5.0  # times what the tests take without a fault, and as many seconds more


def sample(tree: Path, area: str, seed: int) -> Iterator[Mutant]:
    """All mutants of an area in an order that the seed decides."""
    everything = [mutant for file in AREAS[area].paths(tree) for mutant in mutants_of(tree, file)]
    random.Random(f"{seed} {area}").shuffle(everything)
    yield from everything


def tried(path: Path) -> dict[str, dict]:
    """The results in `path`, by the keys of their mutants; the last line of one counts."""
    lines = path.read_text().splitlines() if path.is_file() else []
    return {row["key"]: row for row in map(json.loads, lines)}


def try_area(sandbox: Sandbox, name: str, area: Area, count: int, seed: int, results: Path, again: bool) -> list[dict]:
    """The rows of `count` mutants of an area: those known, and the others, tried now."""
    known, rows, times = tried(results), [], OUT / f"{name}_times.json"
    patience = 0.0
    for mutant in sample(sandbox.tree, name, seed):
        if len(rows) == count:
            break
        row = known.get(mutant.key)
        if row is None or (again and row["outcome"] == SURVIVED):
            if not patience:
                began = time.monotonic()
                outcome, where = sandbox.run(None, area, 1800.0, times)
                if outcome != SURVIVED:
                    print(f"{name}: some tests fail without a fault and are left out, the first: {where}", flush=True)
                patience = PATIENCE * (time.monotonic() - began) + PATIENCE
                print(f"{name}: the tests take {patience / PATIENCE - 1:.0f} s without a fault", flush=True)
            row = {"key": mutant.key, "area": name, "mutant": str(mutant), "seed": seed}
            began = time.monotonic()
            if sandbox.compiles(mutant):
                row["outcome"], row["by"] = sandbox.run(mutant, area, patience, times)
            else:
                row["outcome"], row["by"] = "no mutant", "the compiler refuses it"
            row["seconds"] = round(time.monotonic() - began, 1)
            with results.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(f"  {row['outcome']:9} {row['seconds']:6.1f} s  {mutant}", flush=True)
        if row["outcome"] != "no mutant":
            rows.append(row)
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--area", action="append", choices=list(AREAS), help="only this area; may be repeated")
    parser.add_argument("--count", type=int, default=PER_AREA, help=f"mutants of an area (default {PER_AREA})")
    parser.add_argument("--seed", type=int, default=1, help="which mutants (default 1)")
    parser.add_argument("--results", type=Path, help="file of results (default build/mutants/seed_<seed>.jsonl)")
    parser.add_argument("--again", action="store_true", help="try those again that survived")
    chosen = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    results = chosen.results or OUT / f"seed_{chosen.seed}.jsonl"
    sandbox = Sandbox(ROOT, OUT)
    rows = []
    for name in chosen.area or AREAS:
        rows += try_area(sandbox, name, AREAS[name], chosen.count, chosen.seed, results, chosen.again)
    print(f"\n{'area':16} {'tried':>5} {'killed':>6} {'timed out':>9} {'survived':>8}")
    for name in dict.fromkeys(row["area"] for row in rows):
        counts = Counter(row["outcome"] for row in rows if row["area"] == name)
        print(f"{name:16} {counts.total():5} {counts[KILLED]:6} {counts[TIMED_OUT]:9} {counts[SURVIVED]:8}")
    counts = Counter(row["outcome"] for row in rows)
    found = counts[KILLED] + counts[TIMED_OUT]
    print(
        f"{'all':16} {counts.total():5} {counts[KILLED]:6} {counts[TIMED_OUT]:9} {counts[SURVIVED]:8}: {found / max(1, len(rows)):.1%}"
    )
    print("\nsurvivors:")
    for row in rows:
        if row["outcome"] in (SURVIVED, BROKEN):
            print(f"  {row['key']} {row['mutant']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
