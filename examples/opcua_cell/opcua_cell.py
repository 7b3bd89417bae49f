"""The bin cell behind a controller that speaks OPC UA: it asks halfseen for each decision, and does what is decided.

::

    halfseen learn examples/bin_cell/logs --out policy
    halfseen serve policy --mapping-template > cell.toml
    python examples/opcua_cell/opcua_cell.py
    halfseen serve policy --opcua opc.tcp://127.0.0.1:4840 --mapping cell.toml --record next-logs

Its state machine is after that of OPC 40100, machine vision: Ready (a request stands), SingleExecution (the arm acts),
ResultReady (the outcome stands), Error (no decision came in time: the trajectory is cut). As a controller's retentive
memory does, the file ``--memory`` keeps what stood when the power went, one line a request.
"""

import argparse
import asyncio
import json
import logging
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import Server, ua

sys.path.append(str(Path(__file__).parents[1] / "bin_cell"))
from bin_cell import BEGIN, HORIZON, SECONDS, Bin, outcomes

NAMESPACE, SCANNED_EVERY_S = "urn:example:cell", 0.002
WRITTEN_EVERY = 50
"""Scans after which all values are written again, with a fresh time stamp."""
LONG, DOUBLE, TEXT = ua.VariantType.UInt32, ua.VariantType.Double, ua.VariantType.String
VARIABLES = (
    {"State": TEXT, "Stage": LONG, "Reward": DOUBLE, "ElapsedS": DOUBLE, "Ending": TEXT, "Request": LONG}
    | dict.fromkeys(Bin.covariates, LONG)
    | {"Action": TEXT, "Decision": LONG, "PolicyState": TEXT, "PolicyError": TEXT}
)
ANSWERS = ("Action", "Decision", "PolicyState", "PolicyError")
"""What halfseen may write."""


@dataclass(frozen=True)
class Standing:
    """What the controller asks, and what came of the action before.

    Parameters
    ----------
    request
        Number of the request.
    stage
        Of the trajectory, from 1.
    state
        Clutter, views and jams.
    reward, elapsed_s
        Of the action before, and the time since the trajectory began [s].
    ending
        Empty while the trajectory goes on.
    did
        The action before.
    """

    request: int = 1
    stage: int = 1
    state: tuple[int, ...] = (0, 0, 0)
    reward: float = 0.0
    elapsed_s: float = 0.0
    ending: str = ""
    did: str = ""


class Cell:
    """A controller with its simulated cell.

    Parameters
    ----------
    server
        Where its variables are.
    seed
        Of what happens.
    time_limit_s
        Until a trajectory without a decision is cut [s].
    memory
        File that keeps what stands; None for none.
    faster
        How much faster than in the cell an action is done.
    """

    def __init__(
        self, server: Server, seed: int = 0, time_limit_s: float = 60.0, memory: Path | None = None, faster: float = 1e9
    ) -> None:
        self.server, self.time_limit_s, self.memory, self.faster = server, time_limit_s, memory, faster
        lines = memory.read_text().splitlines(keepends=True) if memory is not None and memory.exists() else []
        # A line that a loss of power tore has no end.
        kept = [json.loads(line) for line in lines if line.endswith("\n")]
        self.rng = np.random.default_rng([seed, len(kept)])
        self.standing = Standing(**{**kept[-1], "state": tuple(kept[-1]["state"])}) if kept else self.begun(1)
        self.variables: dict[str, Any] = {}
        self.faulty: dict[str, int] = {}
        """Status codes of variables that are not good."""

    async def build(self) -> None:
        """Make the variables."""
        of = await self.server.register_namespace(NAMESPACE)
        folder = await self.server.nodes.objects.add_object(of, "Cell")
        for name, kind in VARIABLES.items():
            self.variables[name] = await folder.add_variable(of, name, "" if kind == TEXT else 0, kind)
            if name in ANSWERS:
                await self.variables[name].set_writable()

    def begun(self, request: int) -> Standing:
        """Begin a trajectory: a part lies under more or less clutter."""
        return Standing(request, state=(int(self.rng.choice(3, p=BEGIN)), 0, 0))

    def after(self, action: str) -> Standing:
        """Tell what an action brings."""
        now, state = self.standing, np.array([self.standing.state])
        found = outcomes(state, Bin.actions.index(action))
        _, reward, is_last, after = found[self.rng.choice(len(found), p=[float(each[0][0]) for each in found])]
        took_s = SECONDS[Bin.actions.index(action)] * self.rng.gamma(6.0, 1.0 / 6.0)
        is_over = bool(is_last[0]) or now.stage == HORIZON
        return Standing(
            request=now.request + 1,
            stage=now.stage + 1,
            state=tuple(int(each) for each in after[0]),
            reward=float(reward[0]),
            elapsed_s=now.elapsed_s + took_s,
            ending="finished" if is_over else "",
            did=action,
        )

    async def show(self, state: str) -> None:
        """Write what stands, the request last."""
        now = self.standing
        values = {"State": state, "Stage": now.stage, "Reward": now.reward, "ElapsedS": now.elapsed_s}
        values |= {"Ending": now.ending, **dict(zip(Bin.covariates, now.state, strict=True)), "Request": now.request}
        for name, value in values.items():
            status = ua.StatusCode(self.faulty.get(name, ua.StatusCodes.Good))
            found = ua.DataValue(ua.Variant(value, VARIABLES[name]), status, datetime.now(UTC))
            await self.variables[name].write_value(found)

    async def answer(self) -> str | None:
        """Wait for the answer to what stands; None if it comes too late."""
        loop = asyncio.get_running_loop()
        until_s, scans = loop.time() + self.time_limit_s, 0
        while await self.variables["Decision"].read_value() != self.standing.request:
            if loop.time() > until_s and not self.standing.ending:
                return None
            await asyncio.sleep(SCANNED_EVERY_S)
            scans += 1
            if scans % WRITTEN_EVERY == 0:
                await self.show("Ready")
        return await self.variables["Action"].read_value()

    async def step(self) -> Standing:
        """Ask, do, and keep what came of it; the outcome."""
        await self.show("Ready")
        answer, now = await self.answer(), self.standing
        if now.ending:
            return self.keep(self.begun(now.request + 1))
        if answer is None:
            await self.show("Error")
            return self.keep(replace(now, request=now.request + 1, ending="time-out", did=""))
        await self.show("SingleExecution")
        came = self.after(answer)
        await asyncio.sleep((came.elapsed_s - now.elapsed_s) / self.faster)
        self.keep(came)
        await self.show("ResultReady")
        return came

    def keep(self, standing: Standing) -> Standing:
        """Let something stand, also where the power goes."""
        self.standing = standing
        if self.memory is not None:
            with self.memory.open("a") as file:
                file.write(json.dumps(asdict(standing)) + "\n")
        return standing

    async def run(self, num_trajectories: int) -> None:
        """Run so many trajectories, until the end of the last is acknowledged."""
        while num_trajectories:
            num_trajectories -= bool((await self.step()).ending)
        await self.step()


async def prepare(server: Server, url: str, cell: Cell) -> None:
    """Give a server that has not started the variables of a cell."""
    await server.init()
    server.set_endpoint(url)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    server.set_identity_tokens([ua.AnonymousIdentityToken])
    await cell.build()


async def main(args: argparse.Namespace) -> None:
    """Serve, and run the cell."""
    server = Server()
    cell = Cell(server, args.seed, args.time_limit, args.memory, args.faster)
    await prepare(server, args.url, cell)
    async with server:
        print(f"opc.tcp://{server.endpoint.hostname}:{server.bserver.port}", flush=True)
        await cell.run(args.trajectories)
    print(f"{args.trajectories} trajectories are done")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="opc.tcp://127.0.0.1:4840", help="where to serve; port 0 for any")
    parser.add_argument("--trajectories", type=int, default=1000)
    parser.add_argument("--memory", type=Path, help="file that keeps what stands")
    parser.add_argument("--faster", type=float, default=100.0, help="than in the cell")
    parser.add_argument(
        "--time-limit", type=float, default=60.0, help="until a trajectory without a decision is cut [s]"
    )
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        given = _arguments()
        # asyncua logs a traceback of what is refused below in one line.
        logging.getLogger("asyncua.server").setLevel(logging.CRITICAL)
        try:
            asyncio.run(main(given))
        except OSError as error:
            print(f"{given.url}: {error.strerror}; end what listens there, or give another --url", file=sys.stderr)
            sys.exit(2)
