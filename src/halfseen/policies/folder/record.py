"""policy.json: what a policy looks at, what it was learned from and how, and what its weights are worth."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

import halfseen
from halfseen.errors import PolicyError
from halfseen.policies.folder.json_values import names_in, plain, typed
from halfseen.policies.folder.kinds import kind_of
from halfseen.policies.promise import check_promise
from halfseen.reading import json_of

FORMAT, VERSION = "halfseen-policy", 2


def as_json(record: Mapping[str, Any]) -> bytes:
    """Write a record down; the same record gives the same bytes."""
    return (json.dumps(plain(record), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def from_json(data: bytes) -> dict[str, Any]:
    """Read a record, and check that it is one of this version.

    Raises
    ------
    PolicyError
        It is no JSON, describes no policy, or one of another version.
    """
    try:
        record = json_of(data)
    except ValueError as error:
        raise PolicyError(f"it is no JSON ({error}); learn the policy anew") from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise PolicyError("it describes no policy; give a folder that `halfseen learn` wrote")
    if record.get("version") != VERSION:
        raise PolicyError(
            f"version {record.get('version')!r} is not the {VERSION} that halfseen {halfseen.__version__} reads; use "
            "the halfseen that wrote it, or learn the policy anew"
        )
    kind_of(record)
    names_in(record, "column_major", (str,))
    for name in ("schema", "learner", "log", "diagnostics", "reg", "versions"):
        typed(record, name, dict, "an object")
    _check_doubts(record)
    if record.get("promise") is not None:
        try:
            check_promise(record["promise"])
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise PolicyError(f"promise cannot be read ({error}); learn the policy anew") from error
    spread = typed({"reward_spread": 0.0, **record}, "reward_spread", float, "a standard deviation")
    if not 0.0 <= spread < np.inf:
        raise PolicyError(f"reward_spread is {spread}; it is a standard deviation: learn the policy anew")
    left = typed({"stages_left": [], **record}, "stages_left", list, "a list")
    if not all(isinstance(each, float) and each >= 1.0 for each in left):
        raise PolicyError(f"stages_left is {left}; it holds a number from 1 on for each stage: learn the policy anew")
    return record


def _check_doubts(record: Mapping[str, Any]) -> None:
    """Refuse a verdict or warnings that say nothing; folders that were written before there were any have neither."""
    if not all(isinstance(one, str) for one in typed({"warnings": [], **record}, "warnings", list, "a list")):
        raise PolicyError(f"warnings is {record['warnings']!r} and not a list of sentences; learn the policy anew")
    if record.get("verdict") is not None:
        for name in ("verdict", "reason", "sentence"):
            typed(typed(record, "verdict", dict, "an object"), name, str, "a text")
