"""A command line in this process: what it said, or why it was refused."""

from click.testing import CliRunner

from halfseen.cli import halfseen
from halfseen.errors import HalfseenError


def run(*words):
    """Run ``halfseen`` with words that it takes."""
    return CliRunner().invoke(halfseen, [str(word) for word in words], catch_exceptions=False)


def refusal(*words):
    """Run ``halfseen`` with words that it refuses: an error of one line, and nothing is said."""
    result = CliRunner().invoke(halfseen, [str(word) for word in words])
    assert isinstance(result.exception, HalfseenError), result.output
    assert "\n" not in str(result.exception)
    assert result.output == ""
    return result.exception
