"""``python -m fuzz``, from the folder of tests: many cases, a table of what came of them, and files of what failed."""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

from tqdm import tqdm

from fuzz.campaign import TESTS, Result, numbered, run, saved

LONG_S = 10.0
SLOWEST = "slowest [s]"


def main() -> int:
    """Run a campaign, or cases that were kept; the status says whether something is to be mended."""
    asked = argparse.ArgumentParser(prog="python -m fuzz", description=main.__doc__)
    asked.add_argument("--cases", type=int, default=2000, help="how many")
    asked.add_argument("--seed", type=int, default=0, help="the same seed draws the same cases")
    asked.add_argument("--first", type=int, default=0, help="number of the first case")
    asked.add_argument("--workers", type=int, default=2, help="processes")
    asked.add_argument("--limit-s", type=float, default=30.0, help="how long a case may take [s]")
    asked.add_argument(
        "--place", type=Path, default=TESTS.parent / "runs" / "fuzz", help="where inputs and failures go"
    )
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
                told = "" if result.case is None else f"{' '.join(result.case.words)} [{'; '.join(result.case.told)}]"
                bar.write(f"{result.name}: {result.label}: {told[:400]!r}\n    {result.why[-1500:]}")
                if not chosen.replay and result.case is not None:
                    file = chosen.place / f"failed-{chosen.seed}-{result.name}.json"
                    file.write_text(saved(chosen.seed, int(result.name), chosen.place, not chosen.light))

        results = run(orders, chosen.place, chosen.workers, chosen.limit_s, tell)
    print(table(results))
    for result in sorted(results, key=lambda each: -each.seconds)[:5]:
        if result.seconds > LONG_S and result.case is not None:
            print(f"{result.name}: {result.seconds:.0f} s: {' '.join(result.case.words)!r} {result.case.told}")
    print(f"{len(results)} cases in {time.monotonic() - began:.0f} s")
    return int(any(result.is_fault for result in results))


def table(results: list[Result]) -> str:
    """Inputs by what came of them."""
    counts = Counter((result.of, result.label) for result in results)
    inputs, labels = (sorted({key[k] for key in counts}) for k in (0, 1))
    width = max(map(len, inputs), default=0) + 2
    labels = [*labels, SLOWEST]
    rows = [" " * width + "  ".join(labels)]
    for name in (*inputs, "all"):
        cells = [
            sum(n for (of, told), n in counts.items() if told == label and name in (of, "all")) for label in labels
        ]
        cells[-1] = f"{max((each.seconds for each in results if name in (each.of, 'all')), default=0.0):.1f}"
        rows.append(
            f"{name:<{width}}" + "  ".join(f"{n:>{len(label)}}" for n, label in zip(cells, labels, strict=True))
        )
    return "\n".join(rows)


if __name__ == "__main__":
    raise SystemExit(main())
