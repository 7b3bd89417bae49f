"""The policies that `halfseen learn` makes of the examples' logs, which several pictures show something of."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from halfseen.policies.folder import StoredPolicy
from pictures.picture import ROOT

PICK_CELL, BIN_CELL = (ROOT / "examples" / name for name in ("pick_cell", "bin_cell"))


@cache
def example_policy(example: Path = PICK_CELL, *options: str) -> StoredPolicy:
    """Learn it, as the command does."""
    from click.testing import CliRunner

    from halfseen.cli import halfseen
    from halfseen.policies import read_policy

    with TemporaryDirectory() as folder:
        command = ["learn", str(example / "logs"), "--out", f"{folder}/policy", *options]
        done = CliRunner().invoke(halfseen, command, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return read_policy(Path(folder) / "policy")
