"""Random programs through the kernel compiler and through XLA: `python batch_eval/random_programs.py [--count N]`.

Each program chains two to five steps (loops, branches, gathers, scatters, searches, integers of all widths, nested) in float32
or float64, and is compared on 19 rows, by its value or by a derivative; `tests/program_generator.py` says how. Prints what
differs as it is found, and writes the counts by kind to `batch_eval/random_programs.json`. With `--tables` those of
`tests/table_generator.py`, which nest loops and branches that write to arrays in place, by rows and by teams of lanes; their
counts are printed alone. Needs `pip install -e ".[test]"`.
"""

from __future__ import annotations

import argparse
import collections
import importlib.metadata
import json
import sys
import time
from pathlib import Path

import jax
from race import processor

from jaxik import spmd

HERE = Path(__file__).parent
OUT = HERE / "random_programs.json"
TOGETHER = 20  # programs compiled in one call


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--resume", action="store_true", help="go on where the JSON ends; what was wrong is judged again")
    parser.add_argument("--tables", action="store_true", help="programs that write to arrays in place")
    wanted = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_disable_most_optimizations", True)  # XLA's half of the time
    sys.path.insert(0, str(HERE.parent / "tests"))
    if wanted.tables:
        tables(wanted.count)
        return
    import program_generator

    kinds: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    steps: collections.Counter[str] = collections.Counter()
    wrong, before, seed = [], 0.0, 0
    if wanted.resume:
        known = json.loads(OUT.read_text())
        kinds.update({kind: collections.Counter(counts) for kind, counts in known["kinds"].items()})
        steps.update(known["steps"])
        before, seed = known["seconds"], known["seeds"]
        for one in known["wrong"]:
            again = [said for case, said in program_generator.judged([one["seed"]]) if said not in ("", "ill-conditioned")]
            kinds[one["kind"]] += collections.Counter({"wrong": -1, "wrong" if again else "equal": 1})
            wrong += [one] if again else []
    begun = time.time()
    while sum(map(collections.Counter.total, kinds.values())) < wanted.count:
        seeds = [s for s in range(seed, seed + TOGETHER) if program_generator.Case.of(s).possible()]
        for number, (case, said) in zip(seeds, program_generator.judged(seeds), strict=True):
            verdict = said if said in ("", "ill-conditioned") else "wrong"
            kinds[case.kind][verdict or "equal"] += 1
            steps.update({name for name, _ in case.steps})
            if verdict == "wrong":
                wrong.append({"seed": number, "kind": case.kind, "steps": case.steps, "said": said})
                print(wrong[-1], flush=True)
        seed += TOGETHER
        jax.clear_caches()
        result = {
            "processor": processor(),
            "versions": {name: importlib.metadata.version(name) for name in ("jax", "jaxlib", "llvmlite", "numpy")},
            "seeds": seed,
            "seconds": round(before + time.time() - begun),
            "ulps": program_generator.ULPS,
            "kinds": {kind: dict(counts) for kind, counts in sorted(kinds.items())},
            "steps": dict(sorted(steps.items())),
            "wrong": wrong,
        }
        OUT.write_text(json.dumps(result, indent=1) + "\n")
    for kind, counts in sorted(kinds.items()):
        print(f"{kind:40s}", dict(counts))


def tables(count: int) -> None:
    """Runs so many programs that write to arrays in place, half of them by teams; counts refusals by their reason."""
    import table_generator

    said: collections.Counter[str] = collections.Counter()
    for number in range(count):
        case = table_generator.Case.of(number // 2, teams=bool(number % 2))
        k, x, a = case.rows()
        found = spmd.describe(case.function(), k[0], x[0], a).refused or table_generator.judged([case])[0]
        said[found or "equal"] += 1
        if found not in ("", "ill-conditioned"):
            print(case, found, flush=True)
        jax.clear_caches()
    print(dict(said))


if __name__ == "__main__":
    main()
