"""The decision for a part that the guide asks for, drawn as `halfseen act --picture` draws it."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from pictures.example_policy import PICK_CELL, example_policy
from pictures.picture import Picture, Table, whole


def _decided() -> Table:
    """What `halfseen act` says of the part of the guide, by the policy that `halfseen learn` makes."""
    from halfseen.policies import NamedObservation, decider_of

    part = pd.DataFrame({"weight_kg": [0.8], "shine": [0.3], "clutter": [0.6]})
    decision = decider_of(example_policy(PICK_CELL, "--no-verdict")).decide(NamedObservation(part, stage=1))
    return [
        {
            "action": name,
            "q": q,
            "low": decision.intervals[name][0],
            "high": decision.intervals[name][1],
            "chance_best": decision.chance_best[name],
            "reason": decision.reason if name == decision.action else "",
        }
        for name, q in decision.q_values.items()
        if q is not None
    ]


def _draw_decision() -> bytes:
    from halfseen.policies import Decision
    from halfseen.view.decision_picture import draw_decision

    rows = DECISION_NUMBERS.read()
    (chosen,) = (row for row in rows if row["reason"])
    decision = Decision(
        action=chosen["action"],
        q_values={row["action"]: row["q"] for row in rows},
        reason=chosen["reason"],
        warnings=(),
        intervals={row["action"]: (row["low"], row["high"]) for row in rows},
        chance_best={row["action"]: row["chance_best"] for row in rows},
    )
    with TemporaryDirectory() as folder:
        file = Path(folder) / "decision.svg"
        draw_decision(decision, file, stage=1, horizon=4)
        return file.read_bytes()


DECISION_NUMBERS = whole("decision.csv", _decided)


DECISION = Picture("decision", "docs/static/guide/decision.svg", _draw_decision, DECISION_NUMBERS)
