"""What is said of a stage."""

from dataclasses import replace

from watched_runs import stage

from halfseen.watch.wording import stage_html


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
