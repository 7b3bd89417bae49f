"""The figures of examples/, made by the scripts themselves."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from pictures.picture import ROOT, Picture

SCRIPTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("linear_median", "quadratic_median", "dependent_cuts", "ten_covariates"), ()),
    "clinical_trial/clinical_trial": ("--trials", "1"),
}
"""Scripts, and options that save time and change nothing in the figure."""


def importable(folder: str) -> None:
    """Let the modules of an example be imported."""
    sys.path.append(str(ROOT / "examples" / folder))


def _made_by(script: str) -> bytes:
    with TemporaryDirectory() as folder:
        command = [sys.executable, str(ROOT / "examples" / f"{script}.py"), "--out", folder, *SCRIPTS[script]]
        done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ), check=False)
        assert done.returncode == 0, done.stderr
        return (Path(folder) / f"{Path(script).name}.png").read_bytes()


EXAMPLES = tuple(
    Picture(Path(script).name, f"docs/examples/{Path(script).name}.png", partial(_made_by, script), seconds=60.0)
    for script in SCRIPTS
)
