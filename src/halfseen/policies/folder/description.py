"""What the record of a policy says of it, in words: what it looks at, what Q is, and how cuts were treated."""

from collections.abc import Mapping, Sequence
from typing import Any

BASES = {
    "model": "one step ahead under laws fitted to the log, and by simulation what that misses",
    "rule": "worth of a WASH; it never LIFTs",
}
"""What Q is where laws help, by what the policy is built on."""


def description(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Describe a policy by the record in its folder: rows of a name and a text each."""
    weights = record["diagnostics"]["weights"]
    size, largest = weights["effective_sample_size"], weights["largest_weight"]
    return [
        ("looks at", _looks_at(record["kind"], record["schema"])),
        *_q_rows(record),
        *(("chosen", sentence) for sentence in record["chosen"]),
        (
            "weights",
            f"{weights['num_seen']} stages, with an effective sample size of {size:.1f}; the largest weight is "
            f"{largest:.3g}",
        ),
    ]


def _looks_at(kind: str, schema: Mapping[str, Any]) -> str:
    if kind.startswith("team"):
        return f"tables of {schema['num_robots']} robots, and what each is at; it decides for whichever is free"
    if kind.startswith("table"):
        return "tables: where objects stand, who hides whom, how dirty each seems, past attempts"
    return ", ".join(schema["covariates"]) or "nothing but the stage"


def _q_rows(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    learner, schema = record["learner"], record["schema"]
    horizon = f"horizon {schema['horizon']}"
    if (num_robots := schema.get("num_robots")) is not None:
        horizon += f", {schema['horizon'] // num_robots} decisions of each robot"
    if "basis" in schema:
        return [("Q", f"{BASES[schema['basis']]}, {horizon}")]
    is_weighted = learner["censoring"] in ("kaplan-meier", "cox", "kernel")
    by = f", by {learner['censoring_by']}" if is_weighted else ""
    pessimism = (
        f"Q is lowered by {learner['pessimism']:.2g} times its standard error, less where the logs do as much, so that "
        "nothing is chosen on the word of few stages"
    )
    return [
        ("Q", f"{learner['q_function']}, stages {learner['stages']}, {horizon}"),
        *([("pessimism", pessimism)] if learner["pessimism"] else []),
        ("cuts", f"{learner['censoring']}{by}{', augmented' if learner['augmented'] else ''}"),
        ("λ", _regs(**record["reg"])),
    ]


def _regs(values: Sequence[Sequence[float]], rows: str, columns: Sequence[str]) -> str:
    flat = sorted(value for row in values for value in row)
    if flat[0] == flat[-1]:
        return f"{flat[0]:.3g}"
    each = "stage" if rows == "stage" else f"number of {rows}"
    return f"{flat[0]:.3g} to {flat[-1]:.3g}, chosen for each {each}{' and action' if len(columns) > 1 else ''}"
