"""Sessions with real servers of OPC UA on this machine: what variables hold, who may ask, and kills of either side."""

import asyncio
import json
import socket
import subprocess
import sys
import time
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import pytest
from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.uacrypto import der_from_x509, load_certificate
from asyncua.server.user_managers import UserManager
from cryptography.x509.oid import ExtendedKeyUsageOID

from halfseen.errors import ArgumentError
from halfseen.logs import read_logs
from halfseen.serving import Answering, RecordedTrajectories, Served
from halfseen.serving.models import Refusal
from halfseen.serving.opcua import controller
from halfseen.serving.opcua.controller import LOST, connected
from halfseen.serving.opcua.mapping import CellMapping, Reads, Security, Writes
from halfseen.serving.opcua.wire import Wire

pytestmark = pytest.mark.slow

NAMESPACE, ROOT = "urn:test:cell", Path(__file__).parents[2]
TYPES = {
    **dict.fromkeys(("request", "stage", "decision"), ua.VariantType.UInt16),
    **dict.fromkeys(("reward", "elapsed_s", "x1"), ua.VariantType.Float),
    "x2": ua.VariantType.Boolean,
    "action": ua.VariantType.Int32,
    "state": ua.VariantType.String,
    "ending": ua.VariantType.LocalizedText,
}
FIRST = {ua.VariantType.String: "", ua.VariantType.LocalizedText: ua.LocalizedText("")}
MAPPING = CellMapping(
    namespaces={"cell": NAMESPACE},
    reads=Reads(**{name: f"Cell/{name}" for name in ("request", "stage", "reward", "elapsed_s", "ending")}),
    writes=Writes(action="Cell/action", decision="cell:Cell/cell:decision", state="Cell/state"),
    covariates={"x1": "Cell/x1", "x2": "Cell/x2"},
    actions={"A": 7, "B": 8, "C": 9},
    stale_after_s=600.0,
)


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """A machine may be busy."""
    monkeypatch.setattr(controller, "TIME_OUT_S", 120.0)


@asynccontextmanager
async def controller_of(prepare=None, **options):
    """A server with variables, and where it is."""
    server = Server(**options)
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    if prepare is not None:
        await prepare(server)
    of = await server.register_namespace(NAMESPACE)
    folder = await server.nodes.objects.add_object(of, "Cell")
    nodes = {name: await folder.add_variable(of, name, FIRST.get(kind, 0), kind) for name, kind in TYPES.items()}
    for name in ("action", "decision", "state"):
        await nodes[name].set_writable()
    async with server:
        yield nodes, f"opc.tcp://127.0.0.1:{server.bserver.port}"


async def put(node, value, kind, age_s=0.0, **more):
    stamp = datetime.now(UTC) - timedelta(seconds=age_s)
    await node.write_value(ua.DataValue(ua.Variant(value, kind), **{"SourceTimestamp": stamp, **more}))


async def put_all(nodes, **values):
    given = {"stage": 1, "reward": 0.0, "elapsed_s": 0.0, "x1": 0.1, "x2": True} | values
    given["request"] = given.pop("request", 1)  # the last
    for name, value in given.items():
        await put(nodes[name], value, TYPES[name])


async def until(condition):
    """Wait for what is to come; a test that waits in vain ends by the watchdog of the run."""
    while not await condition():
        await asyncio.sleep(0.01)


def holds(node, value):
    async def condition():
        return await node.read_value() == value

    return condition


def test_values_come_with_doubts_and_go_with_types():
    async def main():
        async with controller_of() as (nodes, url), connected(url, MAPPING) as controller:
            await put_all(nodes)
            seen = await controller.read()
            await controller.news(60.0)
            # Single precision, as it is written: 0.1 of a log is not below it.
            assert seen.covariates == {"x1": 0.1, "x2": 1}
            assert type(seen.covariates["x1"]) is float
            assert (seen.ending, seen.whole("request"), seen.number("reward")) == ("", 1, 0.0)
            codes = ua.StatusCodes
            for more, message in (
                (
                    {"age_s": 3600.0},
                    r"x1 is 3(599|6\d\d)\.\d s old, but only 600 s are allowed",
                ),  # the clock ticks each second
                ({"StatusCode": ua.StatusCode(codes.BadSensorFailure)}, "x1 has the quality BadSensorFailure"),
                ({"StatusCode": ua.StatusCode(codes.UncertainLastUsableValue)}, "x1 has the quality Uncertain"),
                ({"SourceTimestamp": None}, "x1 has no timestamp"),
                ({"value": [0.1, 0.2]}, "x1 is an array"),
            ):
                await put(nodes["x1"], more.pop("value", 0.1), TYPES["x1"], **more)
                seen = await controller.read()
                with pytest.raises(Refusal, match=message):
                    seen["covariates.x1"]
            await controller.write({"action": 8, "decision": 3, "error": "is mapped to nothing"})
            assert [await nodes[name].read_value() for name in ("action", "decision")] == [8, 3]
            with pytest.raises(ArgumentError, match="action is 'B', and its variable takes Int32; give codes"):
                controller.typed("action", "B")
            with pytest.raises(
                ArgumentError, match="action is 2147483648, but its variable takes Int32; give it a type"
            ):
                controller.typed("action", 2**31)
            truth = replace(controller, types={"action": ua.VariantType.Boolean})
            assert truth.typed("action", 1).Value == 1
            with pytest.raises(ArgumentError, match="action is 2, but its variable takes Boolean; give it a type"):
                truth.typed("action", 2)

    asyncio.run(main())


def test_what_is_not_there_is_reported(flat):
    async def main():
        result = []
        async with controller_of() as (_, url):
            for changes, line in (
                ({"covariates": {"x1": "Cell/x9"}}, "covariates.x1: the controller has no 'Cell/x9' below Objects"),
                ({"namespaces": {"cell": "urn:other"}}, "request: the controller has no namespace 'urn:other'"),
                ({"actions": {}}, "action is 'A', and its variable takes Int32"),
            ):
                with pytest.raises(ArgumentError, match=line):
                    await Wire(Served(flat), url, msgspec.structs.replace(MAPPING, **changes)).check()
        await Wire(Served(flat), url, MAPPING, tell=result.append).check()
        assert result[0].startswith(f"{url}: no answer")

    asyncio.run(main())


def test_a_controller_that_goes_and_comes_again_is_found_again(flat, tmp_path):
    result = []

    async def main(trajectories):
        wire = Wire(Served(flat, Answering(trajectories=trajectories)), "", MAPPING, tell=result.append)
        async with controller_of() as (nodes, wire.url):
            await put_all(nodes)
            running = asyncio.create_task(wire.run())
            await until(holds(nodes["decision"], 1))

        async def at_the_same_port(server):
            server.set_endpoint(wire.url)

        async with controller_of(at_the_same_port) as (nodes, _):
            await put_all(nodes, request=2, stage=2, reward=1.5, elapsed_s=2.0)
            await until(holds(nodes["decision"], 2))
            await put_all(nodes, request=3, stage=3, ending=ua.LocalizedText("finished"), elapsed_s=4.0)
            await until(holds(nodes["decision"], 3))
            running.cancel()
            await asyncio.wait([running])

    with RecordedTrajectories(tmp_path / "logs", resumes=True) as trajectories:
        asyncio.run(main(trajectories))
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["reward"].tolist() == [1.5, 0.0]
    assert logs.trajectories["ending"].tolist() == ["finished"]
    assert any("no decision is written" in line for line in result)
    assert result[-1].endswith("decisions are written again")


class OneUser(UserManager):
    """Lets one user in, by password or by certificate, and anonymous clients where that is wanted."""

    def __init__(self, certificate):
        self.certificate = certificate

    def get_user(self, iserver, username=None, password=None, certificate=None):
        is_known = (username, password) == ("halfseen", "secret") or certificate == self.certificate
        return User(role=UserRole.User) if is_known else None


async def certified(folder, name, *usages):
    """A certificate and its key."""
    key, certificate = folder / f"{name}.pem", folder / f"{name}.der"
    await setup_self_signed_certificate(key, certificate, f"urn:test:{name}", "localhost", [*usages], {})
    return str(certificate), str(key)


def test_signed_or_encrypted_and_with_a_user_or_a_certificate(flat, tmp_path):
    async def main():
        own, key = await certified(tmp_path, "own", ExtendedKeyUsageOID.CLIENT_AUTH)
        user, user_key = await certified(tmp_path, "user", ExtendedKeyUsageOID.CLIENT_AUTH)
        cell, cell_key = await certified(tmp_path, "cell", ExtendedKeyUsageOID.SERVER_AUTH)
        manager = OneUser(der_from_x509(await load_certificate(user)))

        async def secure(server):
            await server.set_application_uri("urn:test:cell-application")
            policies = ("Basic256Sha256_Sign", "Basic256Sha256_SignAndEncrypt", "Aes256Sha256RsaPss_SignAndEncrypt")
            server.set_security_policy([getattr(ua.SecurityPolicyType, policy) for policy in policies])
            await server.load_certificate(cell)
            await server.load_private_key(cell_key)
            server.set_identity_tokens([ua.X509IdentityToken, ua.UserNameIdentityToken])

        async def asked(url, password, **security):
            files = {"certificate": own, "key": key, "server_certificate": cell}
            mapping = msgspec.structs.replace(MAPPING, security=Security(**{**files, **security}))
            async with connected(url, mapping, password) as controller:
                return (await controller.read()).values["request"]

        async with controller_of(secure, user_manager=manager) as (nodes, url):
            await put_all(nodes, request=5)
            for mode in ("Sign", "SignAndEncrypt"):
                assert await asked(url, "secret", mode=mode, user="halfseen") == 5
                assert await asked(url, None, mode=mode, user_certificate=user, user_key=user_key) == 5
                for wrong in ({"user": "halfseen"}, {"user_certificate": own, "user_key": key}, {}):
                    with pytest.raises(LOST):
                        await asked(url, "guessed", mode=mode, **wrong)
            policy = "Aes256Sha256RsaPss"
            assert await asked(url, "secret", mode="SignAndEncrypt", policy=policy, user="halfseen") == 5
            with pytest.raises(LOST):
                await asked(url, "secret", mode="Sign", user="halfseen", server_certificate=own)
            with pytest.raises(LOST):
                async with connected(url, MAPPING):
                    pass
            with pytest.raises(ArgumentError, match="security: a certificate or its key cannot be used"):
                await asked(url, "secret", mode="Sign", user="halfseen", key=own)
            wrong = msgspec.structs.replace(MAPPING, security=None)
            with pytest.raises(ArgumentError, match="the controller refuses"):
                await Wire(Served(flat), url, wrong).check()

    asyncio.run(main())


HALFSEEN, CELL = ("-m", "halfseen.cli"), ROOT / "examples" / "opcua_cell" / "opcua_cell.py"


@contextmanager
def process(*words):
    """A process until it is killed, and the address that it tells."""
    with subprocess.Popen([sys.executable, *map(str, words)], stdout=subprocess.PIPE, text=True) as started:
        try:
            yield started.stdout.readline().split()[0]
        finally:
            started.kill()


def halfseen(*words):
    command = [sys.executable, *HALFSEEN, *map(str, words)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_a_cell_whose_port_is_taken_says_so_in_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        url = f"opc.tcp://127.0.0.1:{taken.getsockname()[1]}"
        ended = subprocess.run([sys.executable, CELL, "--url", url], check=False, capture_output=True, text=True)
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert ended.stderr.startswith(f"{url}: ")


def lines_of(memory, least):
    """What the controller keeps, once it has so many lines."""
    while True:
        text = memory.read_text() if memory.exists() else ""
        lines = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
        if len(lines) >= least:
            return lines
        time.sleep(0.01)


def test_either_side_is_killed_and_no_decision_is_lost_or_taken_twice(tmp_path):
    policy, mapping, memory = tmp_path / "policy", tmp_path / "cell.toml", tmp_path / "memory.jsonl"
    halfseen("learn", ROOT / "examples" / "bin_cell" / "logs", "--out", policy, "--quiet")
    mapping.write_text(halfseen("serve", policy, "--mapping-template"))
    options = ("--mapping", mapping, "--record", tmp_path / "logs", "--explore", 0.5, "--port", 0, "--monitor-every", 0)
    anywhere, done = "opc.tcp://127.0.0.1:0", 0
    for _ in range(2):
        with process(CELL, "--url", anywhere, "--memory", memory, "--trajectories", 1000, "--faster", 1e9) as url:
            for _ in range(2):
                with process(*HALFSEEN, "serve", policy, "--opcua", url, *options):
                    done = len(lines_of(memory, done + 4))
    check_killed(tmp_path / "logs", lines_of(memory, done))


def check_killed(folder, lines):
    """The log holds what the controller did, each once, with what came of it."""
    logs = read_logs(folder)
    stages = logs.stages.merge(logs.trajectories, on="trajectory")
    stages.index = stages["first_request"] + stages["stage"] - 1
    assert stages.index.is_unique
    assert set(logs.trajectories["cause"].dropna()) <= {"crash"}
    assert (logs.trajectories["ending"] == "cut").sum() <= 1
    for before, after in zip([{}, *lines], lines, strict=False):
        if after["did"]:
            row = stages.loc[after["request"] - 1]
            assert row["action"] == after["did"]
            assert not before or tuple(row[["clutter", "views", "jams"]]) == tuple(before["state"])
            assert after == lines[-1] or row["reward"] == after["reward"]
