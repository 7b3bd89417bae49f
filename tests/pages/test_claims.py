import pytest

from halfseen.evaluation import Estimate
from halfseen.pages.sentences import INCONCLUSIVE, NOT_SUPPORTED, SUPPORTED, Claim


def claim(value, reach, **options):
    gain = Estimate(value, value - reach, value + reach, reach / 2, 40.0)
    return Claim("The policy", "earns more than", "earns less than", "the rule", gain, **options)


@pytest.mark.parametrize(
    ("found", "verdict", "title"),
    [
        (claim(1.0, 0.5), SUPPORTED, "The policy earns more than the rule"),
        (claim(-1.0, 0.5), NOT_SUPPORTED, "The policy earns less than the rule"),
        (claim(0.2, 0.5), INCONCLUSIVE, "The policy shows no significant difference from the rule"),
        (
            claim(1.0, 0.5, p_value=0.02, alpha=0.01),
            INCONCLUSIVE,
            "The policy shows no significant difference from the rule",
        ),
        (claim(1.0, 1.5, p_value=0.001, alpha=0.01), SUPPORTED, "The policy earns more than the rule"),
    ],
)
def test_a_claim_is_judged_by_its_test_or_else_by_its_interval(found, verdict, title):
    assert (found.verdict, found.title) == (verdict, title)


def test_one_template_tells_claim_verdict_estimate_and_test():
    assert claim(1.0, 0.5, p_value=1e-7, alpha=0.01, note="3 against 2").sentence == (
        "The policy earns more than the rule: supported (3 against 2; difference 1.00, 95 % interval 0.50 to 1.50; "
        "adjusted p = 1.0 × 10⁻⁷)."
    )
    assert "adjusted p > 0.99" in claim(0.0, 1.0, p_value=1.0).sentence
    assert claim(0.0, 1.0, decimals=4).sentence.endswith("(difference 0.0000, 95 % interval −1.0000 to 1.0000).")
