"""``python -m fuzz``, from the folder of tests: many cases, a table of what came of them, and files of what failed."""

import argparse
import sys
import time
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from fuzz.campaign import TESTS, Result, numbered, run, saved

LONG_S = 10.0


def main() -> int:
    """Run a campaign, or cases that were kept; the status says whether something is to be mended."""
    asked = argparse.ArgumentParser(prog="python -m fuzz", description=main.__doc__)
    for name, default, text in (
        ("--cases", 2000, "how many"),
        ("--seed", 0, "the same seed draws the same cases"),
        ("--first", 0, "number of the first case"),
        ("--workers", 2, "processes"),
        ("--limit-s", 30.0, "how long a case may take [s]"),
        ("--place", TESTS.parent / "runs" / "fuzz", "where inputs and failures go"),
    ):
        asked.add_argument(name, type=type(default), default=default, help=text)
    asked.add_argument("--light", action="store_true", help="leave out what compiles")
    asked.add_argument("--replay", type=Path, nargs="+", help="run these kept cases instead")
    chosen = asked.parse_args()
    chosen.place.mkdir(parents=True, exist_ok=True)
    numbers = range(chosen.first, chosen.first + chosen.cases)
    orders = (
        [{"file": str(file.absolute())} for file in chosen.replay]
        if chosen.replay
        else numbered(chosen.seed, numbers, not chosen.light)
    )
    began = time.monotonic()
    with tqdm(total=len(orders), unit="case", mininterval=0.2 if sys.stderr.isatty() else 60.0) as bar:

        def tell(result: Result) -> None:
            bar.update()
            if result.is_fault:
                made = (
                    "" if result.case is None else f"{' '.join(result.case.words)} [{'; '.join(result.case.mutations)}]"
                )
                bar.write(f"{result.name}: {result.label}: {made[:400]!r}\n    {result.why[-1500:]}")
                if not chosen.replay and result.case is not None:
                    file = chosen.place / f"failed-{chosen.seed}-{result.name}.json"
                    file.write_text(saved(chosen.seed, int(result.name), chosen.place, not chosen.light))

        results = run(orders, chosen.place, chosen.workers, chosen.limit_s, tell)
    print(table(results))
    for result in sorted(results, key=lambda each: -each.seconds)[:5]:
        if result.seconds > LONG_S and result.case is not None:
            print(f"{result.name}: {result.seconds:.0f} s: {' '.join(result.case.words)!r} {result.case.mutations}")
    print(f"{len(results)} cases in {time.monotonic() - began:.0f} s")
    return int(any(result.is_fault for result in results))


def table(results: list[Result]) -> str:
    """Inputs by what came of them."""
    rows = pd.DataFrame({"of": [r.of for r in results], "label": [r.label for r in results]})
    counts = pd.crosstab(rows["of"], rows["label"], margins=True, margins_name="all")
    counts["slowest [s]"] = [max(r.seconds for r in results if name in (r.of, "all")) for name in counts.index]
    return counts.rename_axis(index=None, columns=None).to_string(float_format="{:.1f}".format)


if __name__ == "__main__":
    raise SystemExit(main())
