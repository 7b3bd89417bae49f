"""Kinds of policies that a folder can hold; another kind is one more file and one more entry here."""

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from halfseen.errors import ArgumentError, PolicyError
from halfseen.policies.folder.arrays import Arrays

if TYPE_CHECKING:
    from halfseen.logs import Logs


@runtime_checkable
class PolicyKind(Protocol):
    """What differs between the folders of one kind of policy and those of another."""

    policy_type: type
    """Class of the policies."""

    def facts(self, logs: "Logs") -> Any:
        """What the schema needs of a log, or of a part of it."""
        ...

    def schema(self, policy: Any, facts: Sequence[Any]) -> dict[str, Any]:
        """What the policy looks at and chooses from, for policy.json.

        ``actions`` names the blocks of coefficients, unless ``blocks`` does.
        """
        ...

    def seen(self, logs: "Logs", policy: Any, is_by_stage: bool) -> list[dict[str, Any]]:
        """Ranges of what the policy looks at, in the log that it was learned from."""
        ...

    def range_names(self, policy: Any) -> tuple[str, ...]:
        """Names of these ranges."""
        ...

    def arrays_of(self, policy: Any) -> dict[str, Any]:
        """Name the arrays of a policy."""
        ...

    def policy_of(self, record: Mapping[str, Any], arrays: Arrays) -> Any:
        """Put a policy together again; all of it is checked."""
        ...


_PLACES = {
    "flat": ("named_kind", "NamedKind"),
    "table": ("table_kind", "TableKind"),
    "table-laws": ("laws_kind", "LawsKind"),
    "team": ("team_kind", "TeamKind"),
    "team-laws": ("team_laws_kind", "TeamLawsKind"),
}


@cache
def kind_named(name: str) -> PolicyKind:
    """Load a kind; that of tables brings the world, which takes longer than what the other is asked for."""
    module, kind = _PLACES[name]
    return getattr(import_module(f"{__package__}.{module}"), kind)()


def kind_name_of(policy: Any) -> str:
    """Name of the kind that a policy is of.

    Raises
    ------
    ArgumentError
        It is of none.
    """
    for name in _PLACES:
        if isinstance(policy, kind_named(name).policy_type):
            return name
    types = ", ".join(kind_named(name).policy_type.__name__ for name in _PLACES)
    raise ArgumentError(f"a {type(policy).__name__} cannot be written to a folder; these can: {types}")


def kind_of(record: Mapping[str, Any]) -> PolicyKind:
    """Kind that policy.json says.

    Raises
    ------
    PolicyError
        There is none of this name.
    """
    name = record.get("kind")
    if not isinstance(name, str) or name not in _PLACES:
        listed = ", ".join(map(repr, _PLACES))
        raise PolicyError(f"kind is {name!r}; it is one of {listed}: learn the policy anew")
    return kind_named(name)
