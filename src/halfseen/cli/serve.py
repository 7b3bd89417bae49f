"""``halfseen serve``: a policy that answers over HTTP or OPC UA; ``halfseen record``: logs from a program's calls."""

import asyncio
import logging
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import click

from halfseen.cli import options
from halfseen.cli.inputs import give_mapping, law_of
from halfseen.cli.messages import tell_warning
from halfseen.cli.options import SHIPPED
from halfseen.errors import ArgumentError, did_you_mean

if TYPE_CHECKING:
    from halfseen.logs import LogRecorder
    from halfseen.policies.exploration import ExplorationTable
    from halfseen.serving.opcua.wire import Wire
    from halfseen.serving.served import Served

TOKEN, PASSWORD = "HALFSEEN_TOKEN", "HALFSEEN_OPCUA_PASSWORD"
HERE = "127.0.0.1"
SHORTEST_TOKEN = 16
ABOVE_0: options.Settings = {"type": options.Real(0.0, min_open=True)}


@options.command("halfseen serve policy --record next-logs --explore 0.1")
def serve(
    policy: Path,
    *,
    host: str = HERE,
    port: options.Port = 8080,
    token: Annotated[str | None, {"envvar": TOKEN}] = None,
    record: Annotated[Path | None, {"metavar": "LOGS"}] = None,
    explore: Annotated[float | Path, {"type": options.ShareOrTable(), "default": "0"}] = 0.0,
    law: Annotated[str | None, options.law("For clouds of a table; by default shipped. ")] = None,
    extrapolate: options.Extrapolate = False,
    fall_back: Annotated[Path | None, {"metavar": "RULE"}] = None,
    out_of_range: Annotated[str | None, options.word("answer", "step-back")] = None,
    against: Annotated[Path | None, {"metavar": "RULE"}] = None,
    share: Annotated[float | None, {"type": options.Real(0.0, 0.5, min_open=True)}] = None,
    most_loss: Annotated[float | None, ABOVE_0] = None,
    time_limit: Annotated[float, ABOVE_0] = 5.0,
    monitor_every: Annotated[float, {"type": options.Real(0.0, 86400.0)}] = 30.0,
    controller: Annotated[str | None, {"flags": "--opcua", "metavar": "URL"}] = None,
    mapping: Path | None = None,
    is_template: Annotated[bool, {"flags": "--mapping-template"}] = False,
    seed: options.Seed = 0,
) -> None:
    """Answer what `halfseen act` answers, over HTTP, by the policy in the folder POLICY. Needs the extra serve.

    POST /decide takes the covariates of a stage as a JSON object; for a policy of tables {"objects": [...]}, as a stage
    of a log has them, or a cloud as multipart. GET /health says that it answers; / is a page of the running cell; /api
    and /openapi.json describe the requests. POST /reload, or the signal SIGHUP, reads the folder again.

    With --record, each decision begins a stage of a log, with its probability; POST /reward completes it, and POST /end
    ends its trajectory: {"ending": "finished"}, or {"ending": "cut", "cause": "operator"}. A cloud is then put where
    the trajectory stands, and {"reward": 5.0, "held": true} says whether its WASH or LIFT held.

    A rule decides outside the logs' range, beyond the policy's horizon, where the policy fails, or after --time-limit;
    the answer, the log and /health say so. For tables, it ends the trajectory, and only far outside.

    With --against, the log says to which of the two each trajectory was assigned, and with what probability; a
    restarted server continues from it. A sentence says when the policy is promoted, or stopped; GET /comparison says
    more.

    With --opcua, halfseen reads a controller's variables and writes its decisions there; HTTP then only reports the
    status. A restarted server continues the trajectory that the last one left.

    Parameters
    ----------
    host
        Address to listen on; one that other machines can reach needs a token.
    token
        Token of each request; better in the environment, as HALFSEEN_TOKEN.
    record
        Record the decisions in this folder of logs.
    explore
        Share of decisions drawn at random among the possible actions; or a CSV table of what to try where, as `halfseen
        learn --exploration` writes.
    fall_back
        Rule (.csv or .toml) that decides where the policy does not; by default the usual action of its log in that
        stage.
    out_of_range
        What to do just outside the logs; by default the rule decides.
    against
        Current rule (.csv or .toml): assign each trajectory at random to it or to the policy, until it is clear which
        earns more. Needs --record.
    share
        With --against: initial share of the policy, by default 0.2; it grows as the largest likely loss shrinks.
    most_loss
        With --against: total that the policy may lose against the rule [reward]; by default it is stopped once it is
        seen to lose.
    time_limit
        Time to wait for the policy before the rule decides [s].
    monitor_every
        With --record: least time between two comparisons of what is earned with the promise, in a separate process [s];
        0 for never.
    controller
        Answer a controller over OPC UA instead, such as opc.tcp://10.0.0.2:4840. Needs --mapping, --record and the
        extra opcua.
    mapping
        With --opcua: which of the controller's variables holds what (TOML).
    is_template
        Only print a mapping template for this policy, or write it to --mapping.
    seed
        Same seed and log, same draws and assignments.
    """
    import numpy as np

    from halfseen.monitoring.dealing import Terms
    from halfseen.serving.app import app_of
    from halfseen.serving.comparing import LiveComparison
    from halfseen.serving.limits import bound_socket
    from halfseen.serving.limits import serve as answer
    from halfseen.serving.recording import RecordedTrajectories
    from halfseen.serving.served import NOBODY, Answering, Served
    from halfseen.serving.watching import Recent, Watch

    if is_template:
        from halfseen.policies import read_policy
        from halfseen.serving.opcua.mapping import template_of

        give_mapping(template_of(read_policy(policy)), mapping)
        return
    _check_token(host, token)
    _check_wire(controller, mapping, record)
    _check_comparison(against, record, share, most_loss)
    if record is not None and record.exists() and policy.exists() and record.samefile(policy):
        raise ArgumentError(f"--record is {record}, the folder of the policy; give another folder for its logs")
    # Create the folder of logs only when there is something to record.
    stays_within = not extrapolate and out_of_range != "answer"
    how: Any = {"extrapolates": extrapolate, "stays_within": stays_within, "rule": fall_back or against}
    served = Served(policy, **how, limit_s=time_limit)
    if served.service.fall_back is None:
        tell_warning(f"{NOBODY}; until then, what the policy does not decide is refused")
    for file in filter(None, dict.fromkeys((fall_back, against))):
        _warn_of_rule(served.service.stored, file)
    if served.service.stored.counts_views:
        served.law = law_of(law or SHIPPED)
    wire = None if controller is None or mapping is None else _wire(served, controller, mapping)
    say = partial(print, flush=True)
    goes_on = record is not None and record.exists()
    kinds = {"is_of_tables": served.service.stored.is_table, "resumes": wire is not None}
    watched: Any = (policy, record, monitor_every, say, served.service.digest)
    epsilon, table = (0.0, _table(served.service.stored, explore)) if isinstance(explore, Path) else (explore, None)
    with (
        bound_socket(host, port) as at,
        nullcontext() if record is None else RecordedTrajectories(record, **kinds) as trajectories,
        nullcontext() if record is None or not monitor_every else Watch(*watched) as watch,
    ):
        if trajectories is not None:
            trajectories.refuse_other_log(served.service.stored)
        rng = np.random.default_rng(seed) if trajectories is None else trajectories.draws(seed)
        recent = Recent(watch)
        served.answering = Answering(epsilon, table, rng, trajectories, recent=recent)
        if against is not None and record is not None:
            terms = Terms(most_loss=most_loss) if share is None else Terms(share, most_loss)
            comparison = LiveComparison(served.service, against, record, terms, seed, say)
            served.answering = replace(served.answering, comparison=comparison)
        address, number = at.getsockname()[:2]
        url = f"http://{f'[{address}]' if ':' in address else address}:{number}"

        def begun() -> None:
            click.echo(f"{url}  (Ctrl+C ends)")
            comparison = served.answering.comparison
            if comparison is not None and comparison.standing.verdict != "going on":
                say(f"{comparison.standing}.")
            if watch is not None and goes_on:
                watch.ended()

        answer(app_of(served, token, wire=wire), at, begun)


def _warn_of_rule(stored: Any, file: Path) -> None:
    """Tell of columns and categories that the policy does not know; requests may still bring them."""
    from halfseen.policies.rule_files import rule_of, unseen

    rule, covariates, categories = rule_of(stored, file), stored.policy.covariates, stored.policy.categories
    for name in (name for name in rule.columns if name not in covariates):
        tell_warning(
            f"{file}: the rule asks for {name}, which the policy does not use; if a request lacks it, the usual "
            f"action of the log is taken instead of the rule's{did_you_mean(name, covariates)}"
        )
    for trouble in unseen(rule.rows, categories):
        tell_warning(f"{file}: {trouble}")


def _check_comparison(against: Path | None, record: Path | None, share: float | None, most_loss: float | None) -> None:
    if against is not None and record is None:
        raise ArgumentError(f"--against is {against}, but the comparison needs a log; give --record LOGS")
    for name, given in {"--share": share, "--most-loss": most_loss}.items():
        if against is None and given is not None:
            raise ArgumentError(f"{name} is {given:g}, but nothing is compared; give --against RULE, too")


def _check_wire(controller: str | None, mapping: Path | None, record: Path | None) -> None:
    if (controller is None) != (mapping is None):
        raise ArgumentError("--opcua and --mapping go together; `halfseen serve POLICY --mapping-template` prints one")
    if controller is None:
        return
    if not controller.startswith("opc.tcp://") or "@" in controller:
        place = controller.rpartition("@")[2]  # do not repeat a password
        raise ArgumentError(f"--opcua names {place}; give opc.tcp://HOST:PORT, and users in --mapping")
    if record is None:
        raise ArgumentError(f"--opcua {controller}: decisions over OPC UA need a log; give --record LOGS")


def _wire(served: "Served", controller: str, mapping: Path) -> "Wire":
    from halfseen.serving.opcua.mapping import read_mapping
    from halfseen.serving.opcua.wire import Wire

    # The wire reports errors of asyncua, in one line each.
    logging.getLogger("asyncua").addHandler(logging.NullHandler())
    to = read_mapping(mapping, served.service.stored)
    wire = Wire(served, controller, to, os.environ.get(PASSWORD))
    asyncio.run(wire.check())
    return wire


def _table(stored: Any, path: Path) -> "ExplorationTable":
    from halfseen.policies.exploration import read_exploration
    from halfseen.policies.rule_files import unseen

    if stored.is_table:
        raise ArgumentError(f"--explore {path}: the policy is of tables of objects; give a share, such as 0.1")
    policy = stored.policy
    table = read_exploration(path, policy.actions, policy.covariates, policy.categories)
    for trouble in unseen(table.rows, policy.categories):
        tell_warning(f"{path}: {trouble}")
    return table


def _check_token(host: str, token: str | None) -> None:
    if token is not None and not (token.isascii() and token.isprintable() and len(token) >= SHORTEST_TOKEN):
        raise ArgumentError(
            f"--token has {len(token)} characters; give {SHORTEST_TOKEN} or more of ASCII, such as "
            "`python -c 'import secrets; print(secrets.token_urlsafe())'` prints"
        )
    if token is None and host not in (HERE, "localhost", "::1"):
        raise ArgumentError(
            f"--host is {host}, which other machines may reach; give a --token or set {TOKEN}, which requests must "
            "carry"
        )


@options.command("halfseen record --out logs < calls.jsonl")
@options.unused_seed
def record(
    source: Path | None = None,
    *,
    out: Path,
    listen: Annotated[str | None, {"metavar": "PORT|SOCKET"}] = None,
    fsync: Annotated[str, options.word("never", "trajectory", "stage", "event")] = "never",
    part_mb: Annotated[int, options.whole(1, 10**6)] = 256,
    reward_unit: str | None = None,
) -> None:
    """Record logs from JSON lines, each answered by a line; they come from SOURCE, or from standard input.

    \b
    {"call": "begin_trajectory", "name": 1, "columns": {"cell": "left"}}
    {"call": "begin_stage", "covariates": {"x": 0.3}, "action": "PICK", "probability": 0.5}
    {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.5}
    {"call": "finish"}

    \b
    begin_stage also takes "objects", "object" and "robot"; complete_stage "own_rewards".
    More calls: still_running; drop_out with "robot" and "cause"; cut with "cause".
    Without "elapsed_s" [s] the clock of this machine is read.

    At the end of the lines, a trajectory in progress is cut with the cause input-ended. A refused line does not affect
    later ones.

    Parameters
    ----------
    out
        Folder of logs; recording continues in an existing one.
    listen
        Read lines from a port of this machine (0 for any), or from a Unix socket, given as a file.
    fsync
        How often to wait for the disk; a power failure loses at most the data since then.
    part_mb
        Size from which on the next trajectory begins a new file of OUT [MB].
    reward_unit
        Unit of rewards, such as parts.
    """  # noqa: D301
    from halfseen.logs import LogRecorder
    from halfseen.logs.protocol import record_lines

    if source is not None and listen is not None:
        raise ArgumentError("SOURCE and --listen are both given; leave one out")
    recorder_of = partial(LogRecorder, out, fsync=fsync, reward_unit=reward_unit, part_bytes=part_mb * 10**6)
    if listen is not None:
        _record_clients(recorder_of, int(listen) if listen.isdecimal() else Path(listen))
        return
    with nullcontext(sys.stdin.buffer) if source is None else _lines_of(source) as lines, recorder_of() as recorder:
        record_lines(recorder, lines, click.echo)


def _lines_of(source: Path) -> BinaryIO:
    from halfseen.reading import NUMBERS, opened, reason_of

    try:
        return opened(source, NUMBERS)
    except OSError as error:
        raise ArgumentError(
            f"{source}: it cannot be read ({reason_of(error)}); give a file of JSON lines, or none for standard input"
        ) from error


def _record_clients(recorder_of: Callable[[], "LogRecorder"], address: int | Path) -> None:
    from halfseen.logs.protocol import HOST, listening, record_clients

    with listening(address) as listener, recorder_of() as recorder:
        where = f"{HOST}:{listener.getsockname()[1]}" if isinstance(address, int) else address
        click.echo(f"{where}  (Ctrl+C ends)")
        record_clients(recorder, listener)
