"""What is said of a stage."""

from dataclasses import replace

import pytest
from watched_runs import stage

from halfseen.watch.stage_view import Option
from halfseen.watch.wording import dirty_colour, stage_html


def test_a_stage_says_what_is_done_why_and_what_else_there_was():
    html = stage_html(stage(2))
    for words in ("stage 2 of 3", "+2.50", "+1.00 to +4.00", "80%", "it may be doubted", "tried: 2", "(out of view)"):
        assert words in html
    assert "<strong>LIFT 0</strong>" in html
    assert "<strong>FINISH</strong>" not in html


def test_nothing_that_is_said_is_taken_for_html():
    html = stage_html(replace(stage(1), reason="<script>alert(1)</script>", events=("<img src=x>",)))
    assert "<script>" not in html
    assert "<img" not in html


def test_intervals_and_chances_have_columns_only_where_one_is_known():
    html = stage_html(replace(stage(1), options=(Option("FINISH", 1.0),)))
    assert "95 %" not in html
    assert "best" not in html


@pytest.mark.parametrize(("is_dirty", "colour"), [(0.0, (86, 180, 233)), (0.5, (225, 225, 225)), (1.0, (213, 94, 0))])
def test_colours_go_from_clean_to_dirty(is_dirty, colour):
    assert dirty_colour(is_dirty) == colour
