"""Record the example logs of the bin: ``logs`` holds 400 parts to learn from, ``later_logs`` 800 that came later.

python examples/bin_cell/record.py
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from bin_cell import CUT_SHARE, Bin

from halfseen.logs import read_logs

NUM_TRAJECTORIES = {"logs": 400, "later_logs": 800}
SEEDS = {"logs": 7, "later_logs": 8}
HERE = Path(__file__).parent


def main(arguments: Sequence[str] | None = None) -> None:
    """Record, read again, and tell what was recorded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE, help="where the folders of logs go; they are replaced")
    options = parser.parse_args(arguments)
    for name, num_trajectories in NUM_TRAJECTORIES.items():
        Bin().log(num_trajectories, SEEDS[name], CUT_SHARE).write(options.out / name, overwrite=True)
        print(f"{options.out / name}: {read_logs(options.out / name).summary()}")


if __name__ == "__main__":
    main()
