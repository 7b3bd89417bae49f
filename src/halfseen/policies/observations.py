"""From files to what a policy decides from: covariates of one stage, or a cloud of a table and its history."""

from pathlib import Path
from typing import TYPE_CHECKING

from halfseen.errors import ArgumentError
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.named_observation import read_covariates

if TYPE_CHECKING:
    from halfseen.policies.named_decider import NamedObservation
    from halfseen.policies.table_observation import SeenLaw
    from halfseen.tables.present import Present


def read_observation(
    stored: StoredPolicy,
    file: Path,
    history: Path | None = None,
    stage: int | None = None,
    labels: Path | None = None,
    law: "SeenLaw | None" = None,
) -> "NamedObservation | Present":
    """Read what a policy decides from.

    Parameters
    ----------
    stored
        The policy.
    file
        For tables a point cloud; for named actions covariates as .json or .csv, one state.
    history
        For tables, a folder of logs whose last trajectory is the one so far.
    stage
        The stage to decide, from 1; None for what the file or the history says, or 1.
    labels
        For tables, what looks dirty, as `halfseen.perception.read_labels` takes it; None for what the colours of the
        cloud tell, if it has some.
    law
        For tables, what a cell's law tells of labels and grips; None for the assumed law of labels.

    Returns
    -------
    NamedObservation or Present
        What the decider of the policy takes.

    Raises
    ------
    HalfseenError
        A file cannot be read, or does not fit the policy.
    """
    if stored.is_table:
        # Clouds take libraries that covariates do not.
        from halfseen.policies.table_observation import read_table

        return read_table(stored, file, history, stage, labels, law).present
    for option, given in (("--history", history), ("--labels", labels)):
        if given is not None:
            raise ArgumentError(f"{option} is for tables; this policy looks at the covariates of the stage alone")
    return read_covariates(stored, file, stage)
