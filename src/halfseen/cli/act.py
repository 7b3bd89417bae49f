"""``halfseen act``: the decision of a policy for what is seen now, and the reason."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    import pandas as pd

    from halfseen.policies.folder import StoredPolicy
    from halfseen.tables import LinearTablePolicy
    from halfseen.tables.present import Present
    from halfseen.world import TableState

_STATE_FILES = (".json", ".csv")


@dataclass(frozen=True)
class Told:
    """A decision and its grounds.

    Parameters
    ----------
    action
        What to do; of a table such as "LIFT 2".
    stage, horizon
        The stage that was decided, from 1, and how many there may be.
    q_values
        Q of each action by name; None where it is not possible.
    reason
        Why it is best, in one sentence.
    warnings
        What is doubtful.
    """

    action: int | str
    stage: int
    horizon: int
    q_values: dict[str, float | None]
    reason: str
    warnings: list[str]


@click.command(epilog="Example: halfseen act policy table.pcd --history logs")
@click.argument("policy", type=click.Path(path_type=Path))
@click.argument("cloud", type=click.Path(path_type=Path))
@click.option("--history", type=click.Path(path_type=Path), help="Of a table: logs whose last path is the one so far.")
@click.option(
    "--stage", type=click.IntRange(min=1), help="Stage to decide, from 1; by default as the input says, or 1."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for programs.")
@click.option("--seed", type=int, default=0, help="Accepted by every verb; nothing here is random.")
def act(policy: Path, cloud: Path, history: Path | None, stage: int | None, as_json: bool, seed: int) -> None:
    """Decide what to do now, by the policy in the folder POLICY, and say why.

    For a policy of tables, CLOUD is a point cloud as `halfseen look` takes; --history tells what was seen and tried on
    this table before. For a policy of named actions, CLOUD is a JSON object such as {"x1": 0.3, "x2": 1, "stage": 2},
    or a CSV file with a header and one row.
    """
    from halfseen.policies.folder import read_policy

    decide = _decide_table if (stored := read_policy(policy)).is_table else _decide_flat
    told = decide(stored, cloud, history, stage)
    report = {"policy": str(policy), "input": str(cloud), **asdict(told)}
    click.echo(json.dumps(report, indent=2, allow_nan=False) if as_json else "\n".join(_lines(told)))


def _decide_table(stored: "StoredPolicy", cloud: Path, history: Path | None, stage: int | None) -> Told:
    import numpy as np

    from halfseen.policies.reasons import table_reason
    from halfseen.world.explanation import action_names

    policy: Any = stored.policy
    now = _present(stored, cloud, history, stage)
    q = _table_q(policy, now.state)
    names = action_names(now.state.num_objects)
    return Told(
        action=names[int(np.argmax(q))],
        stage=now.stage,
        horizon=stored.horizon,
        q_values=_by_name(names, q),
        reason=table_reason(now.state, q),
        warnings=[*now.notes, *_beyond(stored.ranges(now.stage), _table_values(now.state))],
    )


def _present(stored: "StoredPolicy", cloud: Path, history: Path | None, stage: int | None) -> "Present":
    """See the table, and put it where the path stands."""
    from halfseen.errors import ArgumentError, CloudError, LogError, PolicyError
    from halfseen.logs import read_logs
    from halfseen.perception import perceive, read_cloud
    from halfseen.tables.present import first_state, present_state

    if cloud.suffix in _STATE_FILES:
        raise PolicyError(f"{cloud}: the policy is of tables, and this is no point cloud; give .pcd, .ply or .npz")
    logs = None if history is None else read_logs(history)
    scene = perceive(read_cloud(cloud)).scene()
    if scene.num_objects == 0:
        raise CloudError(f"{cloud}: no objects on the table; put the table with its objects whole into the view")
    if logs is None:
        return first_state(scene, stored.horizon, stage or 1)
    try:
        now = present_state(scene, stored.horizon, logs)
    except (LogError, PolicyError) as error:
        raise type(error)(f"{history}: {error}") from error
    if stage not in (None, now.stage):
        raise ArgumentError(
            f"--stage is {stage}, but by {history} the path has come to stage {now.stage}; leave it out"
        )
    return now


def _table_q(policy: "LinearTablePolicy", state: "TableState") -> Any:
    import jax
    import numpy as np

    return np.asarray(jax.jit(type(policy).q_values)(policy, state), dtype=np.float64)


def _table_values(state: "TableState") -> dict[str, dict[str, float]]:
    """What the ranges of a policy of tables are of, and whose value each is."""
    import numpy as np

    tried = np.asarray(state.attempt_object)[:, None] == np.arange(state.num_objects)
    each = {
        "occlusion": 1.0 - np.prod(1.0 - np.asarray(state.hides, dtype=np.float64), axis=1),
        "log_odds": np.asarray(state.log_odds, dtype=np.float64),
        "num_attempts": tried.sum(axis=0),
    }
    by_object = {name: {f"{name} of object {k}": float(v) for k, v in enumerate(each[name])} for name in each}
    return {"num_objects": {"num_objects": float(state.num_objects)}, **by_object}


def _decide_flat(stored: "StoredPolicy", file: Path, history: Path | None, stage: int | None) -> Told:
    import numpy as np

    from halfseen.errors import ArgumentError, LogError, PolicyError
    from halfseen.policies.reasons import flat_reason

    policy: Any = stored.policy
    if history is not None:
        raise ArgumentError("--history is for tables; this policy looks at the covariates of the stage alone")
    row = _state_row(file, policy.covariates)
    number = _stage_of(file, row, stage, stored.horizon)
    try:
        q = policy.q_values(row, number)[0]
    except LogError as error:
        raise PolicyError(f"{file}: {error}") from error
    possible = np.where(policy.is_possible[number - 1], q, -np.inf)
    ranges = stored.ranges(number)
    values = {name: {name: float(row[name].iloc[0])} for name in policy.covariates}
    return Told(
        action=policy.actions[int(np.argmax(possible))],
        stage=number,
        horizon=stored.horizon,
        q_values=_by_name([str(name) for name in policy.actions], possible),
        reason=flat_reason(policy, row, number, ranges),
        warnings=_beyond(ranges, values),
    )


def _state_row(file: Path, covariates: tuple[str, ...]) -> "pd.DataFrame":
    """Read the covariates of one stage from a JSON or CSV file."""
    import pandas as pd

    from halfseen.errors import PolicyError

    looks_at = ", ".join(covariates) or "no covariates"
    if file.suffix not in _STATE_FILES:
        raise PolicyError(
            f"{file}: the policy is of named actions and looks at {looks_at}, not at clouds; give them as .json or .csv"
        )
    try:
        if file.suffix == ".json":
            told = json.loads(file.read_text(encoding="utf-8"))
            row = pd.DataFrame([told]) if isinstance(told, dict) else pd.DataFrame()
        else:
            exact: Any = {"float_precision": "round_trip"}
            row = pd.read_csv(file, **exact)
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise PolicyError(f"{file}: it cannot be read ({reason}); give one state as .json or .csv") from error
    if len(row) != 1:
        raise PolicyError(f"{file}: it holds {len(row)} states; give one: a JSON object, or a header and one row")
    missing = [name for name in covariates if name not in row.columns]
    if missing:
        raise PolicyError(
            f"{file}: the policy looks at {looks_at}, and there is no {missing[0]!r} among "
            f"{', '.join(map(str, row.columns)) or 'nothing'}; give what the policy was learned from"
        )
    return row


def _stage_of(file: Path, row: "pd.DataFrame", given: int | None, horizon: int) -> int:
    from halfseen.errors import ArgumentError, PolicyError

    told = row["stage"].iloc[0] if "stage" in row.columns else given or 1
    if isinstance(told, bool) or not (hasattr(told, "__index__") and 1 <= int(told) <= horizon):
        raise PolicyError(f"{file}: stage is {told}; it is a whole number from 1 to the policy's horizon, {horizon}")
    if given not in (None, int(told)):
        raise ArgumentError(f"--stage is {given}, but {file} says {told}; leave one of them out")
    return int(told)


def _by_name(names: Any, q: Any) -> dict[str, float | None]:
    from math import isfinite

    return {name: float(value) if isfinite(value) else None for name, value in zip(names, q, strict=True)}


def _beyond(ranges: Mapping[str, tuple[float, float]] | None, values: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Say what lies outside what the logs showed, the first of each kind: there Q is extrapolated."""
    if ranges is None:
        return ["no path of the logs came to this stage; Q is extrapolated"]
    told = []
    for name, (low, high) in ranges.items():
        slack = 1e-6 * max(1.0, abs(low), abs(high))
        outside = [(whose, value) for whose, value in values[name].items() if not low - slack <= value <= high + slack]
        for whose, value in outside[:1]:
            told.append(f"{whose} is {value:.4g}, outside the logs ({low:.4g} to {high:.4g}); Q is extrapolated")
    return told


def _lines(told: Told) -> list[str]:
    known = sorted(((name, q) for name, q in told.q_values.items() if q is not None), key=lambda one: -one[1])
    width = max(len("action"), *(len(name) for name, _ in known))
    return [
        told.reason,
        *(f"warning: {one}" for one in told.warnings),
        "",
        f"stage {told.stage} of {told.horizon}",
        f"{'action':<{width}}  {'value':>9}",
        *(f"{name:<{width}}  {q:>+9.2f}" for name, q in known),
    ]
