"""``halfseen serve``: a policy that answers over HTTP, and records what it decides."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.laws import SHIPPED, law_of, law_option
from halfseen.cli.watch import port_option

if TYPE_CHECKING:
    from halfseen.policies.exploration_table import ExplorationTable

TOKEN = "HALFSEEN_TOKEN"
HERE = "127.0.0.1"
SHORTEST_TOKEN = 16


class _ShareOrTable(click.ParamType):
    """A share below 1, or a CSV file."""

    name = "share|file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | Path:
        """Tell them apart by how it ends."""
        if str(value).lower().endswith(".csv"):
            return Path(value)
        share: Any = click.FloatRange(0.0, 1.0, max_open=True)
        return share.convert(value, param, ctx)


@click.command(epilog="Example: halfseen serve policy --record next-logs --explore 0.1")
@click.argument("policy", type=options.PATH)
@click.option("--host", default=HERE, show_default=True, help="Address to answer at; any other needs a token.")
@port_option
@click.option("--token", envvar=TOKEN, help=f"That each request must bring; better in the environment, as {TOKEN}.")
@click.option("--record", type=options.PATH, metavar="LOGS", help="Record what is decided into this folder of logs.")
@click.option(
    "--explore",
    type=_ShareOrTable(),
    default="0",
    show_default=True,
    help="Share of decisions that are drawn at random among the actions that are possible; or a CSV table of what to "
    "try where, as `halfseen learn --exploration` writes.",
)
@law_option(None, f"Of clouds of a table, where it is {SHIPPED} by default. ")
@click.option("--extrapolate", is_flag=True, help="Decide even far outside what the logs showed, with a warning.")
@options.seed("draws of --explore")
def serve(
    policy: Path,
    host: str,
    port: int,
    token: str | None,
    record: Path | None,
    explore: float | Path,
    law: str | None,
    extrapolate: bool,
    seed: int,
) -> None:
    """Answer what `halfseen act` answers, over HTTP, by the policy in the folder POLICY. Needs the extra serve.

    POST /decide takes the covariates of a stage as a JSON object; for a policy of tables {"objects": [...]}, as a stage
    of a log has them, or a cloud as multipart. GET /health tells that it answers; GET / and /openapi.json tell what can
    be asked. POST /reload, or the signal SIGHUP, reads the folder again.

    With --record, each decision begins a stage of a log, with its probability; POST /reward completes it, and POST /end
    ends its trajectory: {"ending": "finished"}, or {"ending": "cut", "cause": "operator"}. A cloud is then put where
    the trajectory stands, and {"reward": 5.0, "held": true} says whether its WASH or LIFT held.
    """
    import numpy as np

    from halfseen.serving.answering import Answering
    from halfseen.serving.app import Served, app_of
    from halfseen.serving.limits import bound_socket
    from halfseen.serving.limits import serve as answer
    from halfseen.serving.recording import RecordedTrajectories

    _check_token(host, token)
    # A folder of logs is begun only where there is something to record.
    served = Served(policy, extrapolates=extrapolate)
    if served.service.counts_views:
        served.law = law_of(law or SHIPPED)
    is_table = served.service.stored.is_table
    epsilon, table = (0.0, _table(served.service.stored, explore)) if isinstance(explore, Path) else (explore, None)
    with (
        bound_socket(host, port) as at,
        nullcontext() if record is None else RecordedTrajectories(record, is_of_tables=is_table) as trajectories,
    ):
        served.answering = Answering(epsilon, table, np.random.default_rng(seed), trajectories)
        address, number = at.getsockname()[:2]
        url = f"http://{f'[{address}]' if ':' in address else address}:{number}"
        answer(app_of(served, token), at, lambda: click.echo(f"{url}  (Ctrl+C ends)"))


def _table(stored: Any, path: Path) -> "ExplorationTable":
    from halfseen.errors import ArgumentError
    from halfseen.policies.exploration_table import read_exploration

    if stored.is_table:
        raise ArgumentError(f"--explore {path}: the policy is of tables of objects; give a share, such as 0.1")
    return read_exploration(path, stored.policy.actions, stored.policy.covariates, stored.policy.categories)


def _check_token(host: str, token: str | None) -> None:
    from halfseen.errors import ArgumentError

    if token is not None and not (token.isascii() and token.isprintable() and len(token) >= SHORTEST_TOKEN):
        raise ArgumentError(
            f"--token has {len(token)} characters; give {SHORTEST_TOKEN} or more of ASCII, such as "
            "`python -c 'import secrets; print(secrets.token_urlsafe())'` prints"
        )
    if token is None and host not in (HERE, "localhost", "::1"):
        raise ArgumentError(
            f"--host is {host}, which others may reach; give a --token, or set {TOKEN}, that requests must bring"
        )
