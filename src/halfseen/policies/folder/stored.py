"""Read back what was learned: it decides the same, to the last bit."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import safetensors
import safetensors.numpy

from halfseen.errors import ArgumentError, PolicyError, within
from halfseen.policies.decision import LASTING_ERROR, QError
from halfseen.policies.folder.files import ARRAYS, RECORD, read_files
from halfseen.policies.folder.kinds import FLAT, PolicyKind, laid_out
from halfseen.policies.folder.record import from_json
from halfseen.policies.ranges import Range

if TYPE_CHECKING:
    from halfseen.logs import Logs
    from halfseen.logs.missing import Missing
else:
    Logs = Any  # Who reads a policy loads no log.

TABLE_RANGES = ("num_objects", "occlusion", "log_odds", "num_attempts")
"""Of a table: objects on it; and of each, its occlusion, its log-odds of DIRTY and its past attempts."""
UNDECIDED = (
    "which looks at what each robot is at, and that is not given here; ask read_policy(FOLDER).policy.decide of a "
    "halfseen.world.TableState"
)
"""What comes of it, where it is to decide."""


@dataclass(frozen=True, eq=False)
class StoredPolicy:
    """A policy that was read from a folder, and what is known of it.

    Parameters
    ----------
    policy
        What decides.
    record
        What policy.json says: versions, schema, what was seen, the learner's parameters, λ, the log, diagnostics,
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
        """For how many robots of a team it decides; None for one that decides for a robot by itself."""
        return self.record["schema"]["num_robots"] if self.record["kind"] in ("team", "team-laws") else None

    @property
    def counts_views(self) -> bool:
        """Whether it learned from logs that count how much of an object has been in view."""
        return self.is_table and self.record["schema"].get("counts_views", False)

    @property
    def whom(self) -> str:
        """For whom it decides."""
        if self.num_robots is not None:
            return f"a team of {self.num_robots} robot{'' if self.num_robots == 1 else 's'}"
        return "one robot by itself" if self.is_table else "no table"

    @property
    def horizon(self) -> int:
        """Number T of stages that a trajectory may have."""
        return int(self.record["schema"]["horizon"])

    @property
    def verdict(self) -> Mapping[str, Any] | None:
        """Whether what was learned beats what made the logs, as found when it was learned; None if not asked."""
        return self.record.get("verdict")

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is doubtful at every decision: that nothing speaks for the policy, and what looks wrong in its log."""
        lines = [f"its log: {one}" for one in self.record.get("warnings", ())]
        if self.verdict is not None and self.verdict["verdict"] != "better":
            lines.insert(0, f"no evidence that this policy beats the rule that made the logs: {self.verdict['reason']}")
        return tuple(lines)

    @property
    def q_error(self) -> QError | None:
        """What is known of the errors of Q; None in a folder without a margin."""
        pessimism = self.record["learner"].get("pessimism")
        if getattr(self.policy, "margin", None) is None or not isinstance(pessimism, int | float) or not pessimism > 0:
            return None
        lasting = LASTING_ERROR * float(self.record.get("reward_spread", 0.0))
        return QError(float(pessimism), tuple(map(float, self.record.get("stages_left", ()))), lasting)

    @property
    def least_rewards(self) -> dict[str, float]:
        """Of each verb of a table, the least that it paid in the log [reward]; empty in a folder that does not say."""
        return {verb: float(paid) for verb, paid in self.record["schema"].get("least_rewards", {}).items()}

    def missing(self, rules: Mapping[str, str] | None = None) -> "Missing":
        """What stands for null in a log: the same as where it was learned; of other covariates, what rules say."""
        filling = getattr(self.policy, "filling", None)
        return rules if filling is None else {**(rules or {}), **filling.fills}

    def ranges(self, stage: int) -> dict[str, Range] | None:
        """What the log showed of each covariate, where Q of this stage was taught; None if nowhere."""
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

    def _seen(self, stage: int) -> dict[str, Any] | None:
        is_by_stage = self.record["reg"].get("rows") == "stage"
        for entry in self.record["seen"]:
            first, last = entry["stages"]
            if first <= stage <= last or not is_by_stage:
                return entry
        return None


def sources_in_words(record: Mapping[str, Any]) -> str:
    """Say which logs a policy was learned from, in one line; "" of a folder of before, which does not."""
    each = [
        f"{one['num_trajectories']:,} trajectories of {one['name'] or 'a log'} ({one['first']} to {one['last']})"
        for one in record["log"].get("sources", ())
    ]
    return ", ".join(each)


def read_policy(folder: str | Path) -> StoredPolicy:
    """Read a policy that `write_policy` wrote, and check all of it; no code of the folder is run.

    Parameters
    ----------
    folder
        The folder.

    Raises
    ------
    PolicyError
        A file is missing, a byte has changed, the version is unknown, or the numbers do not fit the schema.
    """
    folder = Path(folder)
    text, numbers = read_files(folder)
    with within(folder / RECORD):
        record = from_json(text)
    try:
        arrays = safetensors.numpy.load(numbers)
    except (safetensors.SafetensorError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise PolicyError(f"{folder / ARRAYS}: it is no safetensors file ({error}); learn the policy again") from error
    with within(folder):
        return StoredPolicy(policy_of(record, laid_out(arrays, record["column_major"])), record)


def policy_of(record: Mapping[str, Any], arrays: Any) -> Any:
    """Put a policy together again; all of it is checked."""
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
        Why it is of no use here, and what to do instead.
    folder
        Where it was read.

    Raises
    ------
    PolicyError
        It is one of a team.
    """
    if stored.num_robots is not None:
        where = "the policy" if folder is None else f"{folder}: it"
        raise PolicyError(f"{where} decides for {stored.whom}, {trouble}")


def refuse_log_of_team(stored: StoredPolicy, logs: Logs) -> None:
    """Refuse a log of several robots for a policy of one robot's tables, and one of one robot for a policy of a team.

    Raises
    ------
    PolicyError
        The log is of several robots, or of a team of one; or it is not, and the policy is a team's.
    """
    if not stored.is_table and stored.num_robots is None:
        return
    # Policies of named actions do without the world.
    from halfseen.world.log_checks import robots_in

    if stored.num_robots is not None and not robots_in(logs):
        raise PolicyError(
            f"the log is of one robot, and the policy decides for a team of {stored.num_robots}; give a log of such a "
            "team"
        )
    if stored.is_table and robots_in(logs):
        raise PolicyError(
            f"the log is of a team of {robots_in(logs)}, and the policy decides for one robot; take the part of one, "
            "halfseen.tables.agent_view(logs, robot)"
        )


def kind_named(name: str) -> PolicyKind:
    """Kind of this name; those of tables bring the world, which takes longer than what the other is asked for."""
    return FLAT if name == "flat" else _table_kinds()[name]


def kind_name_of(policy: Any) -> str:
    """Name of the kind that a policy is of.

    Raises
    ------
    ArgumentError
        It is of none.
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
