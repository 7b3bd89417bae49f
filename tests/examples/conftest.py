import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path[:0] = [str(EXAMPLES / name) for name in (".", "pick_cell", "bin_cell", "clinical_trial")]
