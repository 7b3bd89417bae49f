"""Reading of learned policies; a policy that was read decides identically, to the last bit."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import safetensors
import safetensors.numpy

from halfseen.errors import ArgumentError, OutOfRangeError, PolicyError, within
from halfseen.lazy import Frame
from halfseen.policies.decision import LASTING_ERROR, QError
from halfseen.policies.folder.files import ARRAYS, RECORD, read_files
from halfseen.policies.folder.kinds import FLAT, PolicyKind, laid_out
from halfseen.policies.folder.record import as_json, from_json
from halfseen.policies.ranges import Range, refuse_outside
from halfseen.shapes import Bool
from halfseen.writing import path_of

if TYPE_CHECKING:
    from halfseen.logs import Logs
    from halfseen.logs.missing import Missing
else:
    Logs = Any  # Reading a policy loads no log.

TABLE_RANGES = ("num_objects", "occlusion", "log_odds", "num_attempts")
"""Ranges of a table: the number of objects; and for each object, occlusion, log-odds of DIRTY and past attempts."""
UNDECIDED = (
    "and needs to know what each robot is doing, which is not given here; call read_policy(FOLDER).policy.decide with "
    "a halfseen.world.TableState"
)
"""End of a refusal to decide: the reason, and what to do instead."""


@dataclass(frozen=True, eq=False)
class StoredPolicy:
    """A policy read from a folder, with its record.

    Parameters
    ----------
    policy
        The policy that decides.
    record
        Content of policy.json: versions, schema, ranges seen, the learner's parameters, λ, the log, diagnostics,
        warnings, the verdict.
    """

    policy: Any
    record: Mapping[str, Any]

    @property
    def is_table(self) -> bool:
        """Whether it decides for tables of objects, for one robot."""
        return self.record["kind"] in ("table", "table-laws")

    @property
    def num_robots(self) -> int | None:
        """Number of robots of a team; None for a policy of a single robot."""
        return self.record["schema"]["num_robots"] if self.record["kind"] in ("team", "team-laws") else None

    @property
    def counts_views(self) -> bool:
        """Whether it was learned from logs that count how much of an object has been in view."""
        return self.is_table and self.record["schema"].get("counts_views", False)

    @property
    def digest(self) -> str:
        """Identifier: the first 12 digits of the SHA-256 of its record and its numbers."""
        digest = hashlib.sha256(as_json(self.record))
        for name, array in sorted(kind_named(self.record["kind"]).arrays_of(self.policy).items()):
            digest.update(name.encode() + array.tobytes())
        return digest.hexdigest()[:12]

    @property
    def whom(self) -> str:
        """The robots that it decides for, in words."""
        if self.num_robots is not None:
            return f"a team of {self.num_robots} robot{'' if self.num_robots == 1 else 's'}"
        return "a single robot" if self.is_table else "named actions"

    @property
    def horizon(self) -> int:
        """Largest number T of stages of a trajectory."""
        return int(self.record["schema"]["horizon"])

    @property
    def verdict(self) -> Mapping[str, Any] | None:
        """Whether the learned policy beats the logging policy, as found when learning; None if not tested."""
        return self.record.get("verdict")

    @property
    def doubts(self) -> tuple[str, ...]:
        """Doubts about every decision: no evidence for the policy, and problems of its log."""
        lines = [f"its log: {one}" for one in self.record.get("warnings", ())]
        if self.verdict is not None and self.verdict["verdict"] != "better":
            lines.insert(0, f"no evidence that this policy beats the rule that made the logs: {self.verdict['reason']}")
        return tuple(lines)

    @property
    def q_error(self) -> QError | None:
        """The errors of Q; None in a folder without a margin."""
        pessimism = self.record["learner"].get("pessimism")
        if getattr(self.policy, "margin", None) is None or not isinstance(pessimism, int | float) or not pessimism > 0:
            return None
        lasting = LASTING_ERROR * float(self.record.get("reward_spread", 0.0))
        return QError(float(pessimism), tuple(map(float, self.record.get("stages_left", ()))), lasting)

    @property
    def least_rewards(self) -> dict[str, float]:
        """The least reward of each verb of a table in the log [reward]; empty in a folder that does not say."""
        return {verb: float(paid) for verb, paid in self.record["schema"].get("least_rewards", {}).items()}

    def missing(self, rules: Mapping[str, str] | None = None) -> "Missing":
        """Replacements of nulls in a log: those used in learning; for other covariates, those of `rules`."""
        filling = getattr(self.policy, "filling", None)
        return rules if filling is None else {**(rules or {}), **filling.fills}

    def ranges(self, stage: int) -> dict[str, Range] | None:
        """Range of each covariate in the log, where Q of this stage was fitted; None if it never was."""
        entry = self._seen(stage)
        if entry is None:
            return None
        return {
            name: seen if isinstance(seen, dict) else (float(seen[0]), float(seen[1]))
            for name, seen in entry["ranges"].items()
        }

    def margins(self, stage: int) -> dict[str, tuple[float, float]]:
        """How far below and above these ranges a state of the log's own cell may lie by chance."""
        entry = self._seen(stage) or {}
        return {name: (float(below), float(above)) for name, (below, above) in entry.get("margins", {}).items()}

    def is_outside(self, rows: Frame) -> Bool[np.ndarray, " m"]:
        """Whether each state of a log lies outside these ranges by more than their margins, so that a rule decides."""
        states: Any = rows[list(self.policy.covariates)]
        each = zip(rows["stage"].tolist(), states.to_dict("records"), strict=True)
        return np.array([self._is_outside(stage, state) for stage, state in each], dtype=bool)

    def _is_outside(self, stage: int, state: Mapping[str, Any]) -> bool:
        try:
            refuse_outside(self.ranges(stage), {name: {name: at} for name, at in state.items()}, self.margins(stage))
        except OutOfRangeError:
            return True
        return False

    def _seen(self, stage: int) -> dict[str, Any] | None:
        is_by_stage = self.record["reg"].get("rows") == "stage"
        for entry in self.record["seen"]:
            first, last = entry["stages"]
            if first <= stage <= last or not is_by_stage:
                return entry
        return None


def sources_in_words(record: Mapping[str, Any]) -> str:
    """Name the logs that a policy was learned from, in one line; "" for an older folder without their names."""
    each = [
        f"{one['num_trajectories']:,} trajectories of {one['name'] or 'a log'} ({one['first']} to {one['last']})"
        for one in record["log"].get("sources", ())
    ]
    return ", ".join(each)


def read_policy(folder: str | Path) -> StoredPolicy:
    """Read a policy written by `write_policy`, and check all of it; no code of the folder is run.

    Parameters
    ----------
    folder
        The folder.

    Raises
    ------
    PolicyError
        A file is missing, a byte has changed, the version is unknown, or the numbers do not fit the schema.
    """
    folder = path_of(folder)
    text, numbers = read_files(folder)
    with within(folder / RECORD):
        record = from_json(text)
    try:
        arrays = safetensors.numpy.load(numbers)
    except (safetensors.SafetensorError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise PolicyError(
            f"{folder / ARRAYS}: it is not a safetensors file ({error}); learn the policy again"
        ) from error
    with within(folder):
        return StoredPolicy(policy_of(record, laid_out(arrays, record["column_major"])), record)


def policy_of(record: Mapping[str, Any], arrays: Any) -> Any:
    """Rebuild a policy, and check all of it."""
    kind = kind_named(record["kind"])
    policy = kind.policy_of(record, arrays)
    names = policy.covariates if kind.is_flat else TABLE_RANGES
    for entry in record["seen"]:
        if set(entry["ranges"]) != set(names):
            raise PolicyError(
                f"seen does not give the range of {', '.join(names) or 'nothing'} in the log, but of "
                f"{', '.join(entry['ranges']) or 'nothing'}; learn the policy again"
            )
    return policy


def refuse_team(stored: StoredPolicy, trouble: str, folder: str | Path | None = None) -> None:
    """Refuse a policy of a team.

    Parameters
    ----------
    stored
        The policy.
    trouble
        Why it cannot be used here, and what to do instead.
    folder
        Where the policy was read.

    Raises
    ------
    PolicyError
        The policy is of a team.
    """
    if stored.num_robots is not None:
        where = "the policy" if folder is None else f"{folder}: it"
        raise PolicyError(f"{where} decides for {stored.whom}, {trouble}")


def refuse_log_of_team(stored: StoredPolicy, logs: Logs) -> None:
    """Refuse a log that does not match the policy: one of several robots for a policy of one, or the reverse.

    Raises
    ------
    PolicyError
        The log is of several robots, or of a team of one, and the policy is not a team's; or the reverse.
    """
    if not stored.is_table and stored.num_robots is None:
        return
    # Policies of named actions do not load the world.
    from halfseen.world.log_checks import robots_in

    if stored.num_robots is not None and not robots_in(logs):
        raise PolicyError(
            f"the log is of one robot, but the policy decides for a team of {stored.num_robots}; give a log of such a "
            "team"
        )
    if stored.is_table and robots_in(logs):
        raise PolicyError(
            f"the log is of a team of {robots_in(logs)}, but the policy decides for one robot; give the view of one "
            "robot, halfseen.tables.agent_view(logs, robot)"
        )


def kind_named(name: str) -> PolicyKind:
    """Return the kind of this name; kinds of tables load the world, which is slow."""
    return FLAT if name == "flat" else _table_kinds()[name]


def kind_name_of(policy: Any) -> str:
    """Return the name of a policy's kind.

    Raises
    ------
    ArgumentError
        The policy is of no kind that can be stored.
    """
    kinds = {"flat": FLAT, **_table_kinds()}
    for name, kind in kinds.items():
        if isinstance(policy, kind.policy_type):
            return name
    types = ", ".join(kind.policy_type.__name__ for kind in kinds.values())
    raise ArgumentError(f"a {type(policy).__name__} cannot be written to a folder; these can: {types}")


def _table_kinds() -> dict[str, PolicyKind]:
    from halfseen.policies.folder.law_kinds import LAW_KINDS
    from halfseen.policies.folder.table_kinds import TABLE_KINDS

    return TABLE_KINDS | LAW_KINDS
