"""A picture of a view: its sentence is true of the table, and its words lie within it."""

import numpy as np
import pytest
from PIL import Image

from drawn_tables import Can, draw
from halfseen.perception import perceive
from halfseen.perception.picture import draw as draw_picture
from halfseen.perception.picture import sentence

BEHIND_TWO = (Can(0.0, 0.1, 0.05, 0.12), Can(-0.06, -0.05, 0.035, 0.11), Can(0.045, -0.05, 0.025, 0.11))


@pytest.fixture(scope="module")
def view():
    return perceive(draw(*BEHIND_TWO).cloud)


def test_the_share_that_several_hide_is_not_said_of_one(view):
    """It said that object 1 alone hides what two hide together."""
    worst = max(view.objects, key=lambda seen: seen.occlusion)
    shares = view.hides[worst.id]
    assert np.sort(shares)[-2] > 0.05
    whole, most = f"({worst.occlusion:.2f})", f"({shares.max():.2f})"
    assert whole != most
    assert sentence(view).endswith(f"is hidden most {whole}, above all by object {shares.argmax()} {most}.")


def test_the_words_below_a_picture_lie_within_it(view, tmp_path):
    draw_picture(view, tmp_path / "view.png")
    below = np.asarray(Image.open(tmp_path / "view.png").convert("L"))[-60:]
    assert below.min() < 100
    assert below[:, :20].min() == below[:, -20:].min() == 255
