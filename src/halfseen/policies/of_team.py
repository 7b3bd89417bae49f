"""Where the policy or the log of one robot is needed, and one of a team is given."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from halfseen.errors import PolicyError
from halfseen.policies.folder.stored import StoredPolicy

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Who refuses a policy loads no log.

UNDECIDED = (
    "which looks at what each robot is at, and that is not given here; ask read_policy(FOLDER).policy.decide of a "
    "halfseen.world.TableState"
)
"""What comes of it, where it is to decide."""


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
        raise PolicyError(
            f"{where} decides for a team of {stored.num_robots} robot{'' if stored.num_robots == 1 else 's'}, {trouble}"
        )


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
