"""Everybody can read the page: by ear, enlarged, with a keyboard, on a phone."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from axe import PAGES, faults_of, in_browser
from halfseen.cli import halfseen

EXAMPLE = Path(__file__).parents[2] / "examples" / "pick_cell"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readable")
    policy, out = str(folder / "policy"), folder / "report.html"
    for words in (
        ["learn", str(EXAMPLE / "logs"), "--out", policy],
        ["report", str(EXAMPLE / "later_logs"), policy, "--out", str(out)],
    ):
        CliRunner().invoke(halfseen, [*words, "--quiet"], catch_exceptions=False)
    return out


@in_browser
@pytest.mark.slow
@PAGES
def test_everybody_can_read_the_page_of_a_policy(page, width_px, scheme):
    assert faults_of([page], width_px, scheme) == []
