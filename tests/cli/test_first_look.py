"""What a look tells of dirt is one number at every door, and by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shell

from halfseen.perception import StainCounter, perceive, read_cloud, write_pcd
from halfseen.scene import table_paths
from halfseen.tables.first_look import PRIOR, first_look
from halfseen.view.stages import watched_cloud
from halfseen.world import WorldConfig


@pytest.fixture(scope="module")
def coloured():
    """A shipped table in white; one cup has a stain, another a pattern of all colours all over."""
    cloud = read_cloud(table_paths()[7])
    view, rng = perceive(cloud), np.random.default_rng(0)
    colours = np.full(cloud.points_m.shape, (238, 236, 230), dtype=np.uint8)
    colours[view.objects[0].pixels[:400]] = (98, 62, 30)
    pattern = view.objects[1].pixels
    colours[pattern] = rng.integers(0, 256, (len(pattern), 3), dtype=np.uint8)
    return replace(cloud, colours=colours), view


def by_hand(occlusion, says_dirty, prior=0.6):
    """By Bayes: a label is right with probability ½ + .3·(1 − occ)^1.5."""
    right = 0.5 + 0.3 * (1.0 - occlusion) ** 1.5
    if_dirty, if_clean = (right, 1.0 - right) if says_dirty else (1.0 - right, right)
    return prior * if_dirty / (prior * if_dirty + (1.0 - prior) * if_clean)


def test_every_door_shows_one_probability_and_a_pattern_tells_nothing(coloured, tmp_path):
    cloud, view = coloured
    look = first_look(view, cloud)
    assert [label.word for label in look.labels] == ["dirty", "unknown", "clean", "clean", "clean"]
    assert look.labels[1].num_stained_px >= StainCounter.fewest_px
    occluded = view.scene().occlusion
    expected = [by_hand(occluded[k], k == 0) if k != 1 else 0.6 for k in range(5)]
    assert look.chances == pytest.approx(expected, abs=1e-6)
    assert WorldConfig().dirty_share == PRIOR
    (stage,) = watched_cloud(cloud, view, None, None, 0).stages
    assert [shown.is_dirty for shown in stage.objects] == look.chances
    assert stage.events[-1] == look.words
    assert look.words.startswith("Labels by colour (dirty: 0; clean: 2, 3, 4; unknown: 1); P(dirty) is 0: 0.8")
    write_pcd(cloud, tmp_path / "a.pcd")
    said = json.loads(shell.run("look", tmp_path / "a.pcd", "--json").output)
    assert [seen["p_dirty"] for seen in said["objects"]] == look.chances
    table = shell.run("look", tmp_path / "a.pcd").output.splitlines()
    assert [line.split()[-1] for line in table[-5:]] == [f"{chance:.2f}" for chance in look.chances]


def test_without_colour_or_file_all_stand_at_the_prior_and_a_file_counts_without_a_policy(coloured, tmp_path):
    cloud, view = coloured
    plain = first_look(view, replace(cloud, colours=None), dirty_share=0.3)
    assert (plain.labels, plain.words) == (None, "")
    assert plain.chances == pytest.approx([0.3] * 5)
    (tmp_path / "l.csv").write_text(
        "object,label\n" + "".join(f"{k},{'dirty' if k == 2 else 'unknown'}\n" for k in range(5))
    )
    told = first_look(view, cloud, tmp_path / "l.csv")
    assert told.chances[2] == pytest.approx(by_hand(view.scene().occlusion[2], True), abs=1e-6)
    assert told.chances[0] == pytest.approx(0.6)
