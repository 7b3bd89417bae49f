"""The mapping file of ``serve --opcua``, which assigns a role to each controller variable; and its template."""

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from halfseen.errors import ArgumentError, did_you_mean
from halfseen.logs.formats.mapping import mapping_in
from halfseen.policies.folder.stored import StoredPolicy

REMEDY = "`halfseen serve POLICY --mapping-template` prints one"
FILES = ("certificate", "key", "server_certificate", "user_certificate", "user_key")
Given: Any = {"frozen": True, "forbid_unknown_fields": True, "kw_only": True}


class Reads(msgspec.Struct, **Given):
    """Browse paths of requests and outcomes."""

    request: str
    stage: str
    reward: str
    elapsed_s: str
    ending: str


class Writes(msgspec.Struct, **Given):
    """Browse paths of answers; None for those that the controller does not need."""

    action: str
    decision: str
    state: str | None = None
    error: str | None = None


class Security(msgspec.Struct, **Given):
    """Signing, encryption and user; file names are relative to the mapping file.

    Parameters
    ----------
    mode, policy
        As offered by the controller.
    certificate, key
        Files of halfseen, .der or .pem.
    server_certificate
        Certificate of the controller; no other is trusted.
    user
        User name; the password is never in a file.
    user_certificate, user_key
        Files of the user, instead of a password.
    """

    mode: Literal["Sign", "SignAndEncrypt"]
    certificate: str
    key: str
    server_certificate: str
    policy: Literal["Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"] = "Basic256Sha256"
    user: str | None = None
    user_certificate: str | None = None
    user_key: str | None = None


class CellMapping(msgspec.Struct, **Given):
    """Locations of a controller's variables.

    Parameters
    ----------
    namespaces
        Namespace addresses by alias; a name without an alias is in the first.
    reads, writes
        Variables of requests and answers.
    covariates
        Browse paths by covariate.
    actions
        Integer codes of actions; empty if the controller takes names.
    stale_after_s
        Largest age of a value that is acted on [s]; None for no limit.
    security
        Security settings; None for plain text.
    """

    namespaces: Annotated[dict[str, str], msgspec.Meta(min_length=1)]
    reads: Reads
    writes: Writes
    covariates: dict[str, str]
    actions: dict[str, int] = {}
    stale_after_s: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    security: Security | None = None

    @property
    def readable(self) -> dict[str, str]:
        """Browse paths of the variables to read, by name; covariates as covariates.NAME."""
        given = {f"covariates.{name}": path for name, path in self.covariates.items()}
        return {**msgspec.structs.asdict(self.reads), "decision": self.writes.decision, **given}

    @property
    def writable(self) -> dict[str, str]:
        """Browse paths of the variables to write, by name."""
        return {name: path for name, path in msgspec.structs.asdict(self.writes).items() if path is not None}

    def code_of(self, action: int | str) -> int | str:
        """The value to write for an action."""
        return self.actions.get(str(action), action)

    def browse_names(self, path: str) -> list[tuple[str, str]]:
        """Split a browse path into pairs of namespace address and name."""
        first = next(iter(self.namespaces))
        parts = [part.partition(":") for part in path.split("/")]
        known = [(alias, name) if alias in self.namespaces else (first, alias + by + name) for alias, by, name in parts]
        return [(self.namespaces[alias], name) for alias, name in known]


def read_mapping(file: Path, stored: StoredPolicy) -> CellMapping:
    """Read the mapping file of a cell.

    Parameters
    ----------
    file
        Mapping file, in the form of `template_of`.
    stored
        The policy that decides there.

    Raises
    ------
    ArgumentError
        The file cannot be read, an entry is missing, unknown or of the wrong type, or it does not fit the policy.
    """
    _refuse_tables(stored)
    mapping, policy = mapping_in(file, CellMapping, REMEDY), stored.policy
    actions = {str(action) for action in policy.actions}
    for key, given, known in (
        ("covariates", mapping.covariates, set(policy.covariates)),
        ("actions", mapping.actions, actions if mapping.actions else set()),
    ):
        if missing := sorted(known - given.keys()):
            raise ArgumentError(f"{file}, {key}: {missing[0]!r} of the policy is missing; add it")
    for name in mapping.actions.keys() - actions:
        raise ArgumentError(f"{file}, actions: the policy has no {name!r}{did_you_mean(name, actions)}; leave it out")
    if len(set(mapping.actions.values())) < len(mapping.actions):
        raise ArgumentError(f"{file}, actions: two of them have the same code; give each its own")
    return msgspec.structs.replace(mapping, security=_beside(file, mapping.security))


def _refuse_tables(stored: StoredPolicy) -> None:
    if stored.is_table:
        raise ArgumentError("--opcua: the policy needs tables of objects, but a variable holds one value; use HTTP")


def _beside(file: Path, security: Security | None) -> Security | None:
    """Resolve file names relative to the mapping file."""
    if security is None:
        return None
    named = {name: getattr(security, name) for name in FILES}
    paths = {name: file.parent / each for name, each in named.items() if each is not None}
    for name, path in paths.items():
        if not path.is_file():
            raise ArgumentError(f"{file}, security.{name}: no such file {path}; name a .der or .pem file")
    if (security.user_certificate is None) != (security.user_key is None):
        raise ArgumentError(f"{file}, security: give both user_certificate and user_key, or neither")
    return msgspec.structs.replace(security, **{name: str(path) for name, path in paths.items()})


def template_of(stored: StoredPolicy) -> str:
    """Template of a mapping file for a policy: its covariates and actions, with each key explained.

    Raises
    ------
    ArgumentError
        The policy is of tables.
    """
    _refuse_tables(stored)
    policy = stored.policy
    covariates = _table({str(name): f"Cell/{name}" for name in policy.covariates})
    actions = _table({str(action): code for code, action in enumerate(policy.actions)}, before="# ")
    template = files("halfseen.serving.opcua").joinpath("mapping.toml.txt").read_text(encoding="utf-8")
    return template.format(covariates=covariates, actions=actions)


def _table(entries: Mapping[str, Any], before: str = "") -> str:
    """Lines of a TOML table, quoted as in JSON."""
    keys = [name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name) for name in entries]
    return "\n".join(f"{before}{key} = {json.dumps(value)}" for key, value in zip(keys, entries.values(), strict=True))
