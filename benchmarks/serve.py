"""Decisions over HTTP: how long a client waits at a steady rate, on one core for the server; percentiles and JSON.

python benchmarks/serve.py [--out runs/benchmarks/serve.json] [--rate 200] [--seconds 60] [--broken 0.05]

The policy is learned from the log that comes with halfseen, examples/pick_cell/logs, with pessimism, and each answer
has intervals and chances of being best. Questions are sent at their times, whether or not the one before was answered:
a server that is late is not asked more slowly. Every answer is compared with what the decider says in this process, and
a share of the requests is broken. The growth of the server's memory is from the first tenth to the end.

Bars: at 200 a second a client waits 3 ms at the median, and 15 ms in 99 of 100 cases, at most.
"""

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from timings import Row, write

from halfseen.learning import CensoredQLearner
from halfseen.logs import read_logs
from halfseen.policies import decider_of, read_policy, write_policy

LOGS = Path(__file__).parents[1] / "examples" / "pick_cell" / "logs"
BARS_MS = {"p50": 3.0, "p99": 15.0}
BROKEN = (b"{", b"[]", b"{}", b'{"weight_kg": "heavy", "shine": 0, "clutter": 0}', b"\xff" * 2000)
NUM_CONNECTIONS = 8
MOST_QUESTIONS = 20_000
"""What is asked more often than that is asked again in the same order: each answer must be the same as before."""


def learned(folder: Path) -> None:
    """Learn a policy of the pick cell."""
    logs = read_logs(LOGS)
    actions = sorted(logs.stages["action"].dropna().unique())
    learner = CensoredQLearner(logs.horizon, actions, logs.stage_covariates, q_function="kernel", pessimism=1.0)
    write_policy(learner.fit(logs), logs, folder)


def questions(folder: Path, num: int, broken_share: float) -> list[tuple[bytes, dict[str, Any] | None]]:
    """Bodies of requests, and what is to be answered; None to what is broken."""
    rng, stored = np.random.default_rng(0), read_policy(folder)
    decider, made = decider_of(stored), []
    for k in range(min(num, MOST_QUESTIONS)):
        stage = int(rng.integers(1, 3))
        ranges = stored.ranges(stage) or {}
        state = {name: float(rng.uniform(low, high)) for name, (low, high) in ranges.items()}
        if rng.random() < broken_share:
            made.append((BROKEN[k % len(BROKEN)], None))
        else:
            decision = decider.decide_known(state, stage)
            said = {"action": decision.action, "q_values": decision.q_values, "reason": decision.reason}
            made.append((json.dumps(state | {"stage": stage}).encode(), said))
    return [made[k % MOST_QUESTIONS] for k in range(num)]


class Connection:
    """One connection that is kept, as a controller keeps it."""

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port

    async def open(self) -> "Connection":
        self.reader, self.writer = await asyncio.open_connection(self.host, self.port)
        return self

    async def ask(self, body: bytes, path: str = "/decide") -> tuple[int, Any]:
        head = f"content-type: application/json\r\ncontent-length: {len(body)}\r\n"
        status, answer = await self._answered(
            f"POST {path} HTTP/1.1\r\nhost: {self.host}\r\n{head}\r\n".encode() + body
        )
        return status, json.loads(answer)

    async def get(self, path: str) -> tuple[int, bytes]:
        return await self._answered(f"GET {path} HTTP/1.1\r\nhost: {self.host}\r\n\r\n".encode())

    async def _answered(self, request: bytes) -> tuple[int, bytes]:
        self.writer.write(request)
        message = (await self.reader.readuntil(b"\r\n\r\n")).lower()
        length = int(message.partition(b"content-length:")[2].split(b"\r\n", 1)[0])
        return int(message.split(b" ", 2)[1]), await self.reader.readexactly(length)


async def load(port: int, asked: list, rate: float, server: psutil.Process) -> dict[str, Any]:
    """Ask at a steady rate; waiting for a free connection counts as waiting."""
    free: asyncio.Queue[Connection] = asyncio.Queue()
    for _ in range(NUM_CONNECTIONS):
        free.put_nowait(await Connection("127.0.0.1", port).open())
    waited_ms, wrong, memory, cpu_s = np.zeros(len(asked)), [], [], sum(server.cpu_times()[:2])

    async def one(k: int, begun_s: float) -> None:
        body, said = asked[k]
        connection = await free.get()
        status, answer = await connection.ask(body)
        waited_ms[k] = (time.perf_counter() - begun_s) * 1e3
        free.put_nowait(connection)
        is_right = (
            {name: answer.get(name) for name in said} == said if said else 400 <= status < 500 and "error" in answer
        )
        if not is_right:
            wrong.append((status, answer, said))

    begin_s, tasks = time.perf_counter(), []
    for k in range(len(asked)):
        await asyncio.sleep(max(0.0, begin_s + k / rate - time.perf_counter()))
        # Timers of the client are late by a millisecond, which no server can mend; whatever else is late counts.
        tasks.append(asyncio.create_task(one(k, time.perf_counter())))
        if k % max(1, len(asked) // 10) == 0:
            memory.append(server.memory_info().rss)
    await asyncio.gather(*tasks)
    memory.append(server.memory_info().rss)
    is_good = np.array([said is not None for _, said in asked])
    return {
        "num_asked": len(asked),
        "num_broken": int((~is_good).sum()),
        "num_wrong": len(wrong),
        "wrong": [str(one)[:300] for one in wrong[:3]],
        "seconds": time.perf_counter() - begin_s,
        "waited_ms": {f"p{p:g}": float(np.percentile(waited_ms[is_good], p)) for p in (50, 90, 99, 99.9, 100)},
        "cpu_ms": (sum(server.cpu_times()[:2]) - cpu_s) / len(asked) * 1e3,
        "grown_mb": (memory[-1] - memory[1]) / 1e6,
    }


def pin(process: psutil.Process, core: int) -> None:
    """Keep a process on one core, where the system can."""
    if hasattr(process, "cpu_affinity"):
        process.cpu_affinity([core])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/serve.json"))
    parser.add_argument("--rate", type=float, default=200.0, help="requests a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--broken", type=float, default=0.05, help="share of requests that are broken")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        policy = Path(folder) / "policy"
        learned(policy)
        asked = questions(policy, int(args.rate * args.seconds), args.broken)
        core = sorted(os.sched_getaffinity(0))[0] if hasattr(os, "sched_getaffinity") else 0
        words = [sys.executable, "-m", "halfseen.cli", "serve", str(policy), "--port", "0"]
        one_thread = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=one_thread) as server:
            try:
                pin(psutil.Process(server.pid), core)
                assert server.stdout is not None
                port = int(server.stdout.readline().split()[0].rpartition(":")[2])
                found = asyncio.run(load(port, asked, args.rate, psutil.Process(server.pid)))
            finally:
                server.kill()
    waited = found["waited_ms"]
    print(f"{found['num_asked']:,} requests at {args.rate:g} a second, {found['num_broken']:,} of them broken")
    print("waited  " + "  ".join(f"{name} {value:.2f} ms" for name, value in waited.items()))
    print(f"of the server's core a request takes {found['cpu_ms']:.2f} ms")
    print(f"wrong answers {found['num_wrong']}; memory grew by {found['grown_mb']:.1f} MB")
    holds = {name: waited[name] <= bar for name, bar in BARS_MS.items()}
    for name, bar in BARS_MS.items():
        print(f"bar: {name} at most {bar:g} ms: {'holds' if holds[name] else 'does not hold'}")
    what = "a decision over HTTP, {} at 200 a second"
    rows = [Row(what.format(name), waited[name], "ms", bar=bar) for name, bar in BARS_MS.items() if args.rate == 200.0]
    write(args.out, {**found, "rate": args.rate, "bars_hold": holds}, rows)
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
