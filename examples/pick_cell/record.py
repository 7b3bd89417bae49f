"""Record the example logs of the cell: 400 parts, one by one, through a `LogRecorder`.

python examples/pick_cell/record.py
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from cell_paths import record

from halfseen.logs import read_logs

NUM_PATHS = 400
SEED = 7
LOGS = Path(__file__).parent / "logs"


def main(arguments: Sequence[str] | None = None) -> None:
    """Record, read again, and tell what was recorded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=LOGS, help="folder of the logs; what it holds is replaced")
    options = parser.parse_args(arguments)
    record(options.out, NUM_PATHS, SEED)
    print(f"{read_logs(options.out).summary()}\nLogs: {options.out}")


if __name__ == "__main__":
    main()
