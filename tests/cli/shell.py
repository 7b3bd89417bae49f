"""A command line in this process, which raises what is wrong."""

import json

from click.testing import CliRunner

from halfseen.cli import halfseen
from halfseen.scene import table_paths

TABLE = str(table_paths()[5])
ROBOT = '[[robot]]\nname = "{}"\nbase_m = [{}, 0.8]\nreach_m = 0.6\n'
LEFT, RIGHT, BEHIND = ROBOT.format("left", -0.4), ROBOT.format("right", 0.4), ROBOT.format("behind", 0.0)


def run(*words):
    """Run ``halfseen`` with words that it takes."""
    return CliRunner().invoke(halfseen, [str(word) for word in words], catch_exceptions=False)


def report(*words):
    """What ``halfseen`` prints for programs."""
    return json.loads(run(*words, "--json").stdout)
