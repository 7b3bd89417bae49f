"""A session with a controller: its variables by name, each with any reason not to act on it."""

import asyncio
import math
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import ua
from asyncua.client.client import Client
from asyncua.common.node import Node
from asyncua.crypto import security_policies, uacrypto
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.ua_binary import variant_to_binary
from cryptography import x509

from halfseen.errors import ArgumentError
from halfseen.logs.columns import FINISHED
from halfseen.reading import reason_of
from halfseen.serving.models import Refusal
from halfseen.serving.opcua.mapping import CellMapping, Security

TIME_OUT_S = 4.0
"""Time limit for an answer of the controller [s]."""
PUBLISHED_EVERY_MS = 10.0
"""Requested interval between notifications of changes [ms]; the controller may choose a longer one."""
CLOCK = "i=2258"
"""The controller's clock: Server_ServerStatus_CurrentTime."""
LOST = (OSError, ua.UaError)
"""Errors of a controller that is unreachable, or refuses."""


@dataclass(frozen=True)
class Snapshot:
    """Values of variables at one time.

    Parameters
    ----------
    values
        Values by name.
    doubts
        Reason not to act on a value, by name; absent for usable values.
    """

    values: Mapping[str, Any]
    doubts: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        """Value of a variable; raises `Refusal` if it must not be acted on."""
        if name in self.doubts:
            raise Refusal(422, f"{name.removeprefix('covariates.')} {self.doubts[name]}")
        return self.values[name]

    def whole(self, name: str) -> int:
        """Value as a nonnegative integer; raises `Refusal` if it is not one, or must not be acted on."""
        value = self[name]
        if not isinstance(value, int) or value < 0:
            raise Refusal(422, f"{name} is {value!r:.40}, not a whole number from 0")
        return value

    def number(self, name: str) -> float:
        """Value as a finite number; raises `Refusal` if it is not one, or must not be acted on."""
        value = self[name]
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise Refusal(422, f"{name} is {value!r:.40}, not a finite number")
        return float(value)

    @property
    def ending(self) -> str:
        """How the trajectory ended, empty while it continues; raises `Refusal` if it must not be acted on."""
        given = "" if self["ending"] is None else self["ending"]
        if not isinstance(given, str):
            raise Refusal(422, f'ending is {given!r:.40}, not text; give "", "finished", or what cut the trajectory')
        text = given.strip()
        return FINISHED if text.lower() == FINISHED else text

    @property
    def covariates(self) -> dict[str, Any]:
        """Covariates by name; raises `Refusal` if one must not be acted on."""
        return {name.removeprefix("covariates."): self[name] for name in self.values if name.startswith("covariates.")}


@dataclass(eq=False)
class Controller:
    """A controller with an open session.

    Parameters
    ----------
    client
        The session.
    reads, writes
        Variables by name.
    types
        Types of the written variables, by name.
    stale_after_s
        As in `CellMapping`.
    """

    client: Client
    reads: Mapping[str, Node]
    writes: Mapping[str, Node]
    types: Mapping[str, ua.VariantType]
    stale_after_s: float | None = None
    _news: asyncio.Event = field(default_factory=asyncio.Event)

    def datachange_notification(self, node: Node, val: Any, data: Any) -> None:
        """Note a new request; called by asyncua."""
        self._news.set()

    async def news(self, limit_s: float) -> None:
        """Wait for a request, at most `limit_s`."""
        try:
            await asyncio.wait_for(self._news.wait(), limit_s)
        except TimeoutError:
            return
        self._news.clear()

    async def read(self) -> Snapshot:
        """Read all variables at once; raises the errors in `LOST`."""
        nodes = [self.client.get_node(CLOCK), *self.reads.values()]
        clock, *found = await self.client.read_attributes(nodes)
        by_name = dict(zip(self.reads, found, strict=True))
        now = max(filter(None, (_value(clock), by_name["request"].SourceTimestamp)), default=None)
        limits_s = {name: self.stale_after_s for name in by_name if name not in ("request", "decision")}
        doubts = {name: _doubt(value, now, limits_s.get(name)) for name, value in by_name.items()}
        values = {name: _plain(_value(value)) for name, value in by_name.items()}
        return Snapshot(values, {name: doubt for name, doubt in doubts.items() if doubt})

    async def write(self, values: Mapping[str, Any]) -> None:
        """Write variables, except those missing in the mapping; raises the errors in `LOST`."""
        typed = {name: ua.DataValue(self.typed(name, value)) for name, value in values.items() if name in self.writes}
        nodes = [self.writes[name].nodeid for name in typed]
        if not nodes:
            return
        for code in await self.client.uaclient.write_attributes(nodes, [*typed.values()], AttributeIds.Value):
            code.check()

    def typed(self, name: str, value: Any) -> ua.Variant:
        """Convert a value to the type of its variable; raises `ArgumentError` if it does not hold the value."""
        kind = self.types[name]
        if isinstance(value, str) and kind != ua.VariantType.String:
            raise ArgumentError(f"{name} is {value!r}, and its variable takes {kind.name}; give codes in [actions]")
        variant = ua.Variant(str(value) if kind == ua.VariantType.String else value, kind)
        try:
            # A Boolean would hold any number as true.
            is_held = kind != ua.VariantType.Boolean or value in (0, 1)
            variant_to_binary(variant)
        except (ua.UaError, AttributeError, TypeError):
            is_held = False
        if not is_held:
            raise ArgumentError(
                f"{name} is {value!r}, but its variable takes {kind.name}; give it a type that holds it"
            )
        return variant


def _doubt(found: ua.DataValue, now: datetime | None, limit_s: float | None) -> str:
    """Reason not to act on a value; empty if there is none."""
    status = found.StatusCode
    if status is not None and not status.is_good():
        return f"has the quality {status.name}"
    if isinstance(_value(found), list | tuple):
        return "is an array, not a single value"
    if limit_s is None:
        return ""
    if found.SourceTimestamp is None or now is None:
        return "has no timestamp, so its age is unknown"
    age_s = (now - found.SourceTimestamp).total_seconds()
    return f"is {age_s:.1f} s old, but only {limit_s:g} s are allowed" if age_s > limit_s else ""


def _value(found: ua.DataValue) -> Any:
    """The value; one of single precision as it is written, since 0.3 would be more than the 0.3 of a log."""
    if found.Value is None:
        return None
    value = found.Value.Value
    is_single = found.Value.VariantType == ua.VariantType.Float and isinstance(value, float)
    return float(str(np.float32(value))) if is_single else value


def _plain(value: Any) -> Any:
    """The value in a type that logs accept."""
    if isinstance(value, ua.LocalizedText):
        return value.Text
    return int(value) if isinstance(value, bool) else value


@asynccontextmanager
async def connected(url: str, mapping: CellMapping, password: str | None = None) -> AsyncIterator[Controller]:
    """Open a session with a controller, and subscribe to its requests.

    Parameters
    ----------
    url
        Address, as opc.tcp://HOST:PORT.
    mapping
        Locations of its variables.
    password
        Password of the user in the mapping.

    Raises
    ------
    ArgumentError
        A variable is not where the mapping says.
    OSError, ua.UaError
        The controller is unreachable, or refuses.
    """
    client = Client(url, timeout=TIME_OUT_S)
    if mapping.security is not None:
        with _usable():
            await _secure(client, mapping.security, password)
    async with client:
        reads, writes = await _nodes(client, mapping, mapping.readable), await _nodes(client, mapping, mapping.writable)
        types = {name: await node.read_data_type_as_variant_type() for name, node in writes.items()}
        controller = Controller(client, reads, writes, types, mapping.stale_after_s)
        subscription = await client.create_subscription(PUBLISHED_EVERY_MS, controller)
        await subscription.subscribe_data_change(reads["request"])
        yield controller


async def _nodes(client: Client, mapping: CellMapping, paths: Mapping[str, str]) -> dict[str, Node]:
    """Find variables by their browse paths."""
    known, objects, nodes = await client.get_namespace_array(), client.nodes.objects, {}
    for name, path in paths.items():
        names = mapping.browse_names(path)
        if strange := [address for address, _ in names if address not in known]:
            raise ArgumentError(f"{name}: the controller has no namespace {strange[0]!r}; it has {', '.join(known)}")
        try:
            nodes[name] = await objects.get_child([ua.QualifiedName(each, known.index(of)) for of, each in names])
        except ua.uaerrors.BadNoMatch as error:
            raise ArgumentError(f"{name}: the controller has no {path!r} below Objects; fix the path") from error
    return nodes


@contextmanager
def _usable() -> Iterator[None]:
    """Refuse an invalid certificate or key."""
    try:
        yield
    except (ValueError, TypeError, x509.ExtensionNotFound) as error:
        raise ArgumentError(f"security: a certificate or its key cannot be used ({reason_of(error)})") from error


async def _secure(client: Client, security: Security, password: str | None) -> None:
    """Set up signing, encryption and the user's identity."""
    certificate = await uacrypto.load_certificate(security.certificate)
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    client.application_uri = next(iter(names.get_values_for_type(x509.UniformResourceIdentifier)), "")
    await client.set_security(
        getattr(security_policies, f"SecurityPolicy{security.policy}"),
        security.certificate,
        security.key,
        server_certificate=security.server_certificate,
        mode=ua.MessageSecurityMode[security.mode],
    )
    if security.user is not None:
        client.set_user(security.user)
        client.set_password(password or "")
    if security.user_certificate is not None and security.user_key is not None:
        await client.load_client_certificate(security.user_certificate)
        await client.load_private_key(Path(security.user_key))
