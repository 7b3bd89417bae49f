"""What would falsify a verdict: probabilities that nobody had, covariates from after the action, cuts called ends.

An estimate that rests on such a log is wrong however narrow its interval is. So nothing is called better or worse by
it, unless whoever asks says that the log is to be trusted in this.
"""

from collections.abc import Collection

from halfseen.errors import ArgumentError
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.logs.plausibility import leaks, outcomes_among_covariates, untrue_probabilities
from halfseen.logs.suspicions import cuts_called_finished

PROBABILITIES, COVARIATES, ENDINGS = TRUST = ("probabilities", "covariates", "endings")
"""What a log may be trusted in."""


def doubt_of(logs: Logs, task: Task, has_probability: bool, trust: Collection[str] = ()) -> str | None:
    """Say why no verdict can rest on a log; None where nothing speaks against it.

    Parameters
    ----------
    logs
        The log.
    task
        What is decided; of covariates, those count that it looks at.
    has_probability
        Whether the logged probabilities are used.
    trust
        Of `TRUST`: what is not to be asked.

    Raises
    ------
    ArgumentError
        There is no such thing to trust in.
    """
    unknown = [name for name in trust if name not in TRUST]
    if unknown:
        raise ArgumentError(f"trust is {unknown[0]!r}; a log may be trusted in {', '.join(TRUST)}")
    looked_at = getattr(task, "covariates", ())
    checks = {
        PROBABILITIES: (untrue_probabilities(logs) if has_probability else ()),
        COVARIATES: (*(leaks(logs, looked_at) if has_probability else ()), *outcomes_among_covariates(logs, looked_at)),
        ENDINGS: cuts_called_finished(logs),
    }
    for name, found in checks.items():
        first = next(iter(found), None) if name not in trust else None
        if first is not None:
            return f"the log cannot be true: {first} (or trust its {name}: --trust-{name})"
    return None
