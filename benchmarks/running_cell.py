"""A cell that asks `halfseen serve` for each decision: how long it waits, and what is left after kill −9.

python benchmarks/running_cell.py [--seconds 60] [--rate 200] [--kills 200] [--out FILE]

The bin of examples/bin_cell asks, by HTTP, a policy that `halfseen learn` made of its logs; some trajectories are cut.

- Load: requests at a steady rate, each when it is due or once the one before is answered; waiting counts from when it
  was due. First the server records alone; then it deals trajectories to the policy and the rule of the cell
  (--against), has the log watched every 5 s, and somebody looks at its page every 2 s. The server and the process that
  watches share one core. Memory is the server's, from the first tenth to the end.
- Kills: the server is killed with −9 while a request is on its way, after a random number of others. No decision may be
  recorded twice, and none lost that was answered; each trajectory must have been dealt as by a server that was never
  killed.

Bars: a decision takes 3 ms at the median, and 15 ms in 99 of 100 cases, at most.
"""

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from serve import BARS_MS, Connection, pin
from timings import Row, write
from worlds.examples import EXAMPLES, bin_cell

from halfseen.errors import NothingRecordedError
from halfseen.logs import Logs, read_logs
from halfseen.monitoring.dealing import Terms, standing
from halfseen.serving.comparing import ARM, CHANCE, LiveComparison, courses_of
from halfseen.serving.in_service import taken_into_service

HERE = "127.0.0.1"
MEAN_UNTIL_CUT_S = 60.0
SHARE, SEED = 0.2, 3
RULE = "jams,action\n> 1,clear\n,grasp\n"
LATEST_TIMER_S = 2e-3
MOST_REQUESTS_A_KILL, LONGEST_WAY_S = 30, 0.004
Asked = tuple[str, dict[str, Any]]


def bin_requests(seed: int) -> Generator[Asked, dict[str, Any], None]:
    """What the bin asks next, given the answer to what it asked last."""
    rng = np.random.default_rng(seed)
    while True:
        state, clock_s, limit_s = (
            np.array([rng.choice(3, p=bin_cell.BEGIN), 0, 0]),
            0.0,
            rng.exponential(MEAN_UNTIL_CUT_S),
        )
        end: dict[str, Any] = {"ending": "finished"}
        for _ in range(bin_cell.HORIZON):
            result = yield "/decide", dict(zip(bin_cell.Bin.covariates, state.tolist(), strict=True))
            action = bin_cell.Bin.actions.index(result["action"])
            clock_s += bin_cell.SECONDS[action] * (1.0 + 0.5 * state[2]) * rng.gamma(6.0, 1.0 / 6.0)
            if clock_s > limit_s:
                end, clock_s = {"ending": "cut", "cause": "operator"}, limit_s
                break
            found = bin_cell.outcomes(state[None], action)
            _, reward, is_last, after = found[rng.choice(len(found), p=[float(each[0][0]) for each in found])]
            yield "/reward", {"reward": float(reward[0]), "elapsed_s": clock_s}
            state = after[0]
            if is_last[0]:
                break
        yield "/end", {**end, "elapsed_s": clock_s}


@contextmanager
def served(*words: str | Path) -> Iterator[tuple[psutil.Process, int]]:
    """A server in a process of its own, and its port."""
    command = [sys.executable, "-m", "halfseen.cli", "serve", *map(str, words), "--port", "0"]
    one_thread = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=one_thread) as server:
        try:
            assert server.stdout is not None
            yield psutil.Process(server.pid), int(server.stdout.readline().split()[0].rpartition(":")[2])
        finally:
            server.terminate()


async def load(port: int, rate: float, seconds: float, server: psutil.Process, *, is_looked_at: bool) -> dict[str, Any]:
    """Run the bin at a steady rate of requests."""
    connection, looker = await Connection(HERE, port).open(), await Connection(HERE, port).open()
    cell, waited, memory = bin_requests(0), {"/decide": [], "/reward": [], "/end": []}, []
    path, body = next(cell)

    async def look() -> None:
        while is_looked_at:
            await asyncio.sleep(2.0)
            for address in ("/state", "/"):
                await looker.get(address)

    cpu_s = sum(server.cpu_times()[:2])
    looking, begin_s, num = asyncio.create_task(look()), time.perf_counter(), int(rate * seconds)
    for k in range(num):
        due_s = begin_s + k / rate
        await asyncio.sleep(max(0.0, due_s - LATEST_TIMER_S - time.perf_counter()))
        # Timers of the client are late by up to a millisecond, which is no wait for the server.
        while time.perf_counter() < due_s:
            pass
        status, answer = await connection.ask(json.dumps(body).encode(), path)
        assert status == 200, answer
        waited[path].append((time.perf_counter() - due_s) * 1e3)
        path, body = cell.send(answer)
        if k % max(1, num // 10) == 0:
            memory.append(server.memory_info().rss)
    looking.cancel()
    answer = json.loads((await connection.get("/state"))[1])
    return {
        "waited_ms": {
            name: {f"p{p}": float(np.percentile(each, p)) for p in (50, 99, 100)} for name, each in waited.items()
        },
        "num": {name: len(each) for name, each in waited.items()},
        "cpu_ms": (sum(server.cpu_times()[:2]) - cpu_s) / num * 1e3,
        "grown_mb": (server.memory_info().rss - memory[1]) / 1e6,
        "memory_mb": server.memory_info().rss / 1e6,
        "comparison": answer.get("comparison"),
        "monitor": answer["monitor"],
    }


@dataclass
class Answers:
    """What a server said before it was killed."""

    decisions: dict[tuple[int, int], dict[str, Any]] = field(default_factory=dict)
    rewards: dict[tuple[int, int], float] = field(default_factory=dict)
    endings: dict[int, str] = field(default_factory=dict)
    at: tuple[int, int] = (0, 0)

    def take(self, path: str, body: dict[str, Any], result: dict[str, Any]) -> None:
        """Keep an answer."""
        if path == "/decide":
            self.at = result["trajectory"], result["stage"]
            assert self.at not in self.decisions, f"{self.at} was decided twice"
            self.decisions[self.at] = result
        elif path == "/reward":
            self.rewards[self.at] = body["reward"]
        else:
            self.endings[self.at[0]] = body["ending"]


async def until_killed(
    port: int, server: psutil.Process, seed: int, num_asked: int, way_s: float, result: Answers
) -> None:
    """Ask so often; then kill the server while the next request is on its way."""
    connection, cell = await Connection(HERE, port).open(), bin_requests(seed)
    path, body = next(cell)
    for _ in range(num_asked):
        status, answer = await connection.ask(json.dumps(body).encode(), path)
        assert status == 200, answer
        result.take(path, body, answer)
        path, body = cell.send(answer)
    asking = asyncio.create_task(connection.ask(json.dumps(body).encode(), path))
    await asyncio.sleep(way_s)
    server.kill()
    try:
        status, answer = await asking
        result.take(path, body, answer)
    except (ConnectionError, asyncio.IncompleteReadError):
        pass  # Nobody knows whether it was taken.
    finally:
        connection.writer.transport.abort()
        await asyncio.sleep(0)


def check_answers(logs: Logs, result: Answers, num_kills: int) -> int:
    """Check that what was answered is in the log, once; how many trajectories were torn."""
    torn = set(logs.trajectories.loc[logs.trajectories["cause"].eq("crash"), "trajectory"])
    keys = list(zip(logs.stages["trajectory"], logs.stages["stage"], strict=True))
    assert len(set(keys)) == len(keys), "a decision was recorded twice"
    rows = dict(zip(keys, logs.stages.to_dict("records"), strict=True))
    lasts = set(logs.stages.groupby("trajectory")["stage"].max().items())
    for key, decision in result.decisions.items():
        assert rows[key]["action"] == decision["action"]
        assert rows[key]["probability"] == decision["probability"]
    unanswered = set(rows) - set(result.decisions)
    assert len(unanswered) <= num_kills
    assert unanswered <= lasts, "a decision in progress is the last"
    for key, reward in result.rewards.items():
        assert rows[key]["reward"] == reward or (key in lasts and key[0] in torn)
    ended = logs.trajectories.set_index("trajectory")["ending"]
    assert all(ended[name] == ending for name, ending in result.endings.items())
    arms = logs.trajectories.set_index("trajectory")[ARM]
    assert all(arms[name] == each["arm"] for (name, _), each in result.decisions.items())
    return len(torn)


def check_dealt(logs: Logs, comparison: LiveComparison) -> None:
    """Check that each trajectory was dealt as one server would have dealt it after all those before it."""
    courses = courses_of(logs, comparison.policy, comparison.name)
    assert courses.num == logs.num_trajectories
    for k in range(courses.num):
        share = standing(courses.part(0, k), comparison.terms).share
        assert courses.chance[k] == logs.trajectories[CHANCE].iloc[k] == share
        assert courses.is_policy[k] == (np.random.default_rng([comparison.seed, k]).random() < share)


def killed(folder: Path, policy: Path, num_kills: int, seed: int = 0) -> dict[str, int]:
    """Kill servers of one log, one after the other, and check what is left."""
    rng, rule, logs, result = np.random.default_rng(seed), folder / "rule.csv", folder / "logs", Answers()
    rule.write_text(RULE)
    words = (policy, "--record", logs, "--against", rule, "--share", SHARE, "--seed", SEED, "--monitor-every", 0)
    for kill in range(num_kills):
        with served(*words) as (server, port):
            num_asked, way_s = int(rng.integers(MOST_REQUESTS_A_KILL)), float(rng.uniform(0.0, LONGEST_WAY_S))
            asyncio.run(until_killed(port, server, kill, num_asked, way_s, result))
    try:
        found = read_logs(logs)
    except NothingRecordedError:
        found = None
    assert found is not None, "something was recorded"
    num_torn = check_answers(found, result, num_kills)
    check_dealt(found, LiveComparison(taken_into_service(policy), rule, logs, Terms(SHARE), SEED))
    return {
        "kills": num_kills,
        "trajectories": found.num_trajectories,
        "torn": num_torn,
        "decisions": len(found.stages),
        "unanswered": len(found.stages) - len(result.decisions),
    }


def learned(folder: Path) -> Path:
    """Learn a policy of the bin."""
    words = ["learn", str(EXAMPLES / "bin_cell" / "logs"), "--out", str(folder), "--quiet"]
    subprocess.run([sys.executable, "-m", "halfseen.cli", *words], check=True, stdout=subprocess.DEVNULL)
    return folder


def loaded(folder: Path, policy: Path, rate: float, seconds: float) -> dict[str, Any]:
    """Load a server that records, and one that also compares, has the log watched, and is looked at."""
    rule = folder / "rule.csv"
    rule.write_text(RULE)
    ways = {
        "alone": ("--monitor-every", 0),
        "compared and watched": ("--against", rule, "--share", SHARE, "--seed", SEED, "--monitor-every", 5),
    }
    found, core = {}, sorted(os.sched_getaffinity(0))[0] if hasattr(os, "sched_getaffinity") else 0
    for name, words in ways.items():
        with served(policy, "--record", folder / name, *words) as (server, port):
            pin(server, core)
            found[name] = asyncio.run(load(port, rate, seconds, server, is_looked_at=name != "alone"))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/running_cell.json"))
    parser.add_argument("--rate", type=float, default=200.0, help="requests a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--kills", type=int, default=200)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        policy = learned(Path(scratch) / "policy")
        found: dict[str, Any] = loaded(Path(scratch), policy, args.rate, args.seconds)
        for name, each in found.items():
            print(f"{name}: {each['num']['/end']:,} trajectories, {args.rate:g} requests a second")
            for path, waited in each["waited_ms"].items():
                print(f"  {path:8}" + "  ".join(f"{p} {value:6.2f} ms" for p, value in waited.items()))
            print(f"  {each['monitor']['sentence']}" if each["monitor"] else "  not watched yet")
            print(f"  a request takes {each['cpu_ms']:.2f} ms of the server's core")
            print(f"  memory {each['memory_mb']:.0f} MB, grew by {each['grown_mb']:.1f} MB")
        if args.kills:
            found["kills"] = killed(Path(scratch), policy, args.kills)
            print("kill -9: " + ", ".join(f"{name} {value}" for name, value in found["kills"].items()))
    waited, what = (
        found["compared and watched"]["waited_ms"]["/decide"],
        "a decision, compared and watched, {} at 200 a second",
    )
    rows = [Row(what.format(name), waited[name], "ms", bar=bar) for name, bar in BARS_MS.items() if args.rate == 200.0]
    write(args.out, found, rows)
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
