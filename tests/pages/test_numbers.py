import math

import pytest

from halfseen.pages.numbers import percent, significant, with_interval
from halfseen.pages.sentences import as_sentence, counted, listed


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (-0.0297, "−0.0297"), (12345.6, "12,346"), (1e-9, "1.00e−09"), (None, "–"), (math.inf, "–")],
)
def test_amounts_have_three_digits_and_a_true_minus(value, text):
    assert significant(value) == text


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ((0.1012, 0.0242, 0.1782), ("0.10", "0.02 to 0.18")),
        ((0.0004, -0.012, 0.013), ("0.000", "−0.012 to 0.013")),
        ((-1234.0, -2000.0, -400.0), ("−1,234", "−2,000 to −400")),
        ((3.0, 3.0, 3.0), ("3.00", "3.00 to 3.00")),
        ((1.0, -math.inf, math.inf), ("1.00", "–")),
        ((math.nan, math.nan, math.nan), ("–", "–")),
    ],
)
def test_a_value_has_as_many_decimals_as_its_interval_makes_worthwhile(numbers, told):
    assert with_interval(*numbers) == told


def test_a_share_that_is_not_quite_none_or_all_does_not_read_so():
    told = [percent(share).replace("\u00a0", " ") for share in (0.0, 0.001, 0.5, 0.999, 1.0)]
    assert told == ["0 %", "< 1 %", "50 %", "> 99 %", "100 %"]


def test_lists_counts_and_sentences_read_as_such():
    assert (listed([]), listed(["a"]), listed(["a", "b"])) == ("", "a", "a and b")
    assert (counted(1, "stage"), counted(1200, "stage")) == ("1 stage", "1,200 stages")
    assert (as_sentence("is it?"), as_sentence("it is")) == ("Is it?", "It is.")
