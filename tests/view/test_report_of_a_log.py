"""The page about a log alone; and units, shares and hours on the page about a policy."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from page_reader import Reader

from halfseen.evaluation.evaluation import PerHour, Rate
from halfseen.logs import Logs
from halfseen.view.findings import find
from halfseen.view.page import page_of
from halfseen.view.words import answer_of, standing, why_no_hours
from small_report import CAUSE, estimate, evaluation, hostile_log

UNIT = "<i>net</i> picks"


def words_of(page):
    return " ".join("".join(Reader(page).words).split())


@pytest.fixture(scope="module")
def findings():
    return find(None, hostile_log().in_unit(UNIT))


def test_it_tells_of_the_log_and_of_nothing_else(findings):
    page = page_of(findings, "halfseen report logs --seed 0")
    read, words = Reader(page), words_of(page)
    sections = [name for name in read.ids if name in ("value", "log", "weights", "policy", "unknown", "again")]
    assert sections == ["log", "weights", "unknown", "again"]
    assert all(link[1:] in read.ids for link in read.links if link.startswith("#"))
    assert read.tags.count("svg") == 5
    assert "<title>What these logs hold</title>" in page
    assert answer_of(findings) in words
    assert CAUSE in words
    assert f"Rewards are in {UNIT}." in words
    assert f"mean reward [{UNIT}]" in words
    for of_a_policy in ("learned policy", "Q:", "Bands", "doubly robust"):
        assert of_a_policy not in words
    assert page_of(find(None, hostile_log().in_unit(UNIT)), "halfseen report logs --seed 0") == page


def one_stage(ends):
    """Trajectories of one stage: (end, whether it finished)."""
    end_s, is_done = (np.array(each) for each in zip(*ends, strict=True))
    done = {"elapsed_s": np.where(is_done, end_s, np.nan), "reward": np.where(is_done, 1.0, np.nan)}
    trajectories = {"trajectory": range(len(ends)), "end_s": end_s, "ending": np.where(is_done, "finished", "cut")}
    return Logs(
        pd.DataFrame({"trajectory": range(len(ends)), "stage": 1, "action": "A", **done}), pd.DataFrame(trajectories)
    )


@pytest.mark.parametrize(
    ("ends", "says"),
    [
        ([(2.0, True)], "1 trajectory, which was not cut; every trajectory counts once"),
        ([(2.0, False)], "1 trajectory: it was cut, by unknown; what was seen stands badly"),
        ([(2.0, True), (3.0, True)], "2 trajectories, none of them cut"),
        ([(2.0, False), (3.0, False)], "2 trajectories: all were cut, by unknown; what was seen stands badly"),
    ],
)
def test_the_smallest_logs_have_a_page_without_empty_parts(ends, says):
    findings = find(None, one_stage(ends))
    page = page_of(findings, "x")
    words = words_of(page)
    assert says in words
    num_finished = sum(is_done for _, is_done in ends)
    assert ("Actions of completed stages" in words) == (num_finished > 0)
    assert Reader(page).tags.count("svg") == (5 if num_finished else 2)
    assert not re.search(r"\b(nan|None)\b", words)


def rated(value, reach):
    return Rate(estimate(3600.0 * value, 3600.0 * reach), estimate(13.0, 1.0))


def test_what_is_earned_is_told_of_today_and_in_an_hour():
    per_hour = PerHour(rated(0.1, 0.02), rated(0.05, 0.01))
    known = evaluation(reward_unit="parts", share=estimate(1.5, 0.2), per_hour=per_hour)
    said = standing(known).replace("\u00a0", " ")
    assert said == (
        "The best estimate is 1.50 parts a trajectory: 150 % of today’s (130 to 170 %) and 360 parts an hour (288 to "
        "432), where today’s is 180."
    )
    assert why_no_hours(known) == ""
    assert standing(evaluation()) == ""
    # Where too few trajectories follow the policy, its value is not to be believed, in whatever unit.
    few = replace(known, doubly_robust=replace(known.doubly_robust, effective_sample_size=3.0))
    assert standing(few) == ""
