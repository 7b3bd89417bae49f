"""Numbers, sentences and colours of what people look at."""

import math

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from halfseen.evaluation import Estimate
from halfseen.figures import HUES, learned_shades
from halfseen.wording import (
    INCONCLUSIVE,
    NOT_SUPPORTED,
    SUPPORTED,
    Claim,
    as_sentence,
    counted,
    listed,
    percent,
    significant,
    with_interval,
)


def test_amounts_shares_lists_and_sentences_read_as_such():
    amounts = {
        0.0: "0",
        -0.0297: "−0.0297",
        12345.6: "12,346",
        1.2e12: "1.20e+12",
        1e-9: "1.00e−09",
        None: "–",
        math.inf: "–",
    }
    assert {value: significant(value) for value in amounts} == amounts
    # A share that is not quite none or all does not read so.
    result = [percent(share).replace("\u00a0", " ") for share in (0.0, 0.001, 0.5, 0.999, 1.0)]
    assert result == ["0 %", "< 1 %", "50 %", "> 99 %", "100 %"]
    assert (listed([]), listed(["a"]), listed(["a", "b"])) == ("", "a", "a and b")
    assert (counted(1, "stage"), counted(1200, "stage")) == ("1 stage", "1,200 stages")
    assert (as_sentence("is it?"), as_sentence("it is")) == ("Is it?", "It is.")


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((0.1012, 0.0242, 0.1782), ("0.10", "0.02 to 0.18")),
        ((0.0004, -0.012, 0.013), ("0.000", "−0.012 to 0.013")),
        ((-1234.0, -2000.0, -400.0), ("−1,234", "−2,000 to −400")),
        ((3.0, 3.0, 3.0), ("3.00", "3.00 to 3.00")),
        ((1.42e-7, 1.01e-7, 1.93e-7), ("1.42e−07", "1.01e−07 to 1.93e−07")),
        ((12263681070.0, 12218724933.0, 12308637206.0), ("1.2264e+10", "1.2219e+10 to 1.2309e+10")),
        ((3.0, 3.0 - 1e-9, 3.0 + 1e-9), ("3.000000", "3.000000 to 3.000000")),
        ((1.0, -math.inf, math.inf), ("1.00", "–")),
        ((math.nan, math.nan, math.nan), ("–", "–")),
    ],
)
def test_a_value_has_as_many_decimals_as_its_interval_makes_worthwhile(numbers, message):
    assert with_interval(*numbers) == message


def claim(value, reach, **options):
    gain = Estimate(value, value - reach, value + reach, reach / 2, 40.0)
    return Claim("The policy", "earns more than", "earns less than", "the rule", gain, **options)


@pytest.mark.parametrize(
    ("found", "verdict", "title"),
    [
        (claim(1.0, 0.5), SUPPORTED, "The policy earns more than the rule"),
        (claim(-1.0, 0.5), NOT_SUPPORTED, "The policy earns less than the rule"),
        (claim(0.2, 0.5), INCONCLUSIVE, "The policy shows no significant difference from the rule"),
        (claim(1.0, 0.5, p_value=0.02, alpha=0.01), INCONCLUSIVE, "The policy shows no significant difference from"),
        (claim(1.0, 1.5, p_value=0.001, alpha=0.01), SUPPORTED, "The policy earns more than the rule"),
    ],
)
def test_a_claim_is_judged_by_its_test_or_else_by_its_interval(found, verdict, title):
    assert found.verdict == verdict
    assert found.title.startswith(title)


def test_one_template_tells_claim_verdict_estimate_and_test():
    assert claim(1.0, 0.5, p_value=1e-7, alpha=0.01, note="3 against 2").sentence == (
        "The policy earns more than the rule: supported (3 against 2; difference 1.00, 95 % interval 0.50 to 1.50; "
        "adjusted p = 1.0 × 10⁻⁷)."
    )
    assert "adjusted p > 0.99" in claim(0.0, 1.0, p_value=1.0).sentence
    assert claim(0.0, 1.0, decimals=4).sentence.endswith("(difference 0.0000, 95 % interval −1.0000 to 1.0000).")


def luminance(colour):
    """Relative luminance, by the Web Content Accessibility Guidelines 2.2."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


def contrast(one, other="white"):
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


def test_colours_can_be_read_and_distinguished():
    for num in (1, 4, 7):
        shades = learned_shades(num)
        assert np.all(np.diff([luminance(shade) for shade in shades]) > 0.0)
        assert all(contrast(shade) > 2.0 for shade in shades)
    assert len({to_rgb(colour) for colour in HUES.values()}) == len(HUES)
    assert all(contrast(colour) > 3.0 for colour in HUES.values())
