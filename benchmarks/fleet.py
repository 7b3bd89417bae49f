"""What the logs of a fleet would take, on paper: from what `streaming.py --keep` measured.

python benchmarks/fleet.py

It prints the sentences of the guide, which tests/docs/test_numbers_in_prose.py compares.
"""

import json

from streaming import KEPT, slope_of

NUM_STAGES, NUM_MACHINES, NUM_CORES = 10_000_000_000, 100, 2
NAMES = {"paper": "eq. 3 of the paper", "default": "the default"}


def hours(cpu_s):
    """On all cores of all machines."""
    return NUM_STAGES * cpu_s / (NUM_MACHINES * NUM_CORES) / 3600.0


def sentences(results):
    """What the guide says of memory, and of the time of each recipe."""
    # What is held of a trajectory is the same by either; where compiling takes more for small logs, it grows unseen.
    memory = max(slope_of(results, recipe)[1] for recipe in NAMES)
    result = [f"A stage takes {memory:.0f} bytes on the machine that asks: {NUM_STAGES * memory / 1e9:.0f} GB in all."]
    for recipe, name in NAMES.items():
        kept, _ = slope_of(results, recipe)
        forgotten, _ = slope_of(results, recipe, is_kept=False)
        result.append(
            f"By {name} it takes {1e6 * kept:.1f} µs of a core, {hours(kept):.1f} hours in all; read anew in each "
            f"pass, {1e6 * forgotten:.1f} µs and {hours(forgotten):.1f} hours."
        )
    return result


def main():
    print("\n".join(sentences(json.loads(KEPT.read_text()))))


if __name__ == "__main__":
    main()
