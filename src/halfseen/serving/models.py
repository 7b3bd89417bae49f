"""Requests and answers: a class for each JSON object. They validate requests, and define the OpenAPI schema."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

Of = TypeVar("Of", bound=Struct)
Schema = dict[str, Any]

BODY, OCTETS = "the request", "application/octet-stream"


def _is(description: str) -> Meta:
    return Meta(description=description)


File = Annotated[Path, Meta(extra_json_schema={"type": "string", "contentMediaType": OCTETS})]
Stage = Annotated[int, Meta(ge=1, description="The stage to decide, a whole number from 1.")]
Clock = Annotated[
    float | None, _is("Seconds since the trajectory began, always or never; by default, the server's clock.")
]
Held = _is(
    "True or false, with clouds only: whether the WASH or LIFT succeeded. Without it, a WASH succeeded if its object "
    "is gone, and a LIFT is not counted."
)
Action = Annotated[int | str, _is("The action by name; on a table, such as LIFT 2.")]
Target = Annotated[Any, _is("On tables: the object acted on, as the log names it; null if none.")]
Trajectory = Annotated[int | str, _is("Name under which it is recorded.")]
InProgress = Annotated[
    int | str | None,
    _is("The name of the trajectory in progress, if another is to be refused; by default, any is taken."),
]
Why = Annotated[
    Literal["out-of-range", "beyond-horizon", "failed", "late"],
    _is("Why the rule decided in the policy's place; only where it did."),
]
Arm = Annotated[
    Literal["policy", "rule"], _is("In a comparison: whether the trajectory was assigned to the policy or the rule.")
]
Amount = float | None
Digest = Annotated[str, _is("Digest of the policy that decides.")]


class State(Struct):
    """Covariates of a stage, by name."""

    stage: Stage | UnsetType = UNSET
    trajectory: InProgress = None


class TableRequest(Struct):
    """Objects of a table."""

    objects: Annotated[
        list[dict[str, Any]],
        Meta(
            min_length=1, description="A list with each object as a stage of a log has it, or send a cloud as a form."
        ),
    ]
    stage: Stage | UnsetType = UNSET
    trajectory: InProgress = None


class CloudRequest(Struct):
    """A look at a table."""

    cloud: Annotated[File, _is("A file of what the camera sees: .pcd, .ply or .npz.")]
    labels: Annotated[File, _is("A .csv or .json of labels, as for halfseen look --labels.")] | UnsetType = UNSET
    stage: Stage | UnsetType = UNSET
    trajectory: InProgress = None


class StageReward(Struct, forbid_unknown_fields=True):
    """What a stage brought."""

    reward: Annotated[float, _is("A number, in the unit of the log.")]
    elapsed_s: Clock = None
    held: Annotated[bool | None, Held] = None
    trajectory: InProgress = None


class TrajectoryEnd(Struct, forbid_unknown_fields=True):
    """How a trajectory ended."""

    ending: Annotated[Literal["finished", "cut"], _is('The word "finished", or "cut" if it did not end by itself.')]
    cause: Annotated[str | None, _is("What cut it, such as operator; with cut alone.")] = None
    elapsed_s: Clock = None
    trajectory: InProgress = None

    def __post_init__(self) -> None:
        if (self.ending == "cut") != (self.cause is not None):
            raise ValueError('give {"ending": "finished"}, or {"ending": "cut", "cause": "operator"}, or what cut it')


class DecisionAnswer(Struct, frozen=True, kw_only=True):
    """What is done, and why."""

    action: Action
    probability: Annotated[float, _is("With which this action was taken.")]
    is_explored: Annotated[bool, _is("Whether it was drawn to explore.")]
    stage: Stage
    horizon: Annotated[int, _is("Stages that the policy decides.")]
    q_values: Annotated[
        dict[str, float | None],
        _is("Value by which the policy chooses [reward]; null for actions that are not possible."),
    ]
    reason: Annotated[str, _is("Why the policy takes it, in one sentence.")]
    warnings: Annotated[list[str], _is("Doubts about the decision, the gravest first.")]
    intervals: Annotated[dict[str, tuple[float, float]], _is("95 % interval of Q [reward], if known.")]
    chance_best: Annotated[dict[str, float], _is("Probability that no action is better, if known.")]
    filled: Annotated[list[str], _is("Covariates that were missing and are filled in; warnings give the values.")]
    policy: Digest
    seen: Annotated[str, _is("With clouds: the labels.")] | UnsetType = UNSET
    verb: Annotated[str, _is("On tables: the action without its object.")] | UnsetType = UNSET
    object: Target | UnsetType = UNSET
    trajectory: Trajectory | UnsetType = UNSET
    stepped_back: Why | UnsetType = UNSET
    arm: Arm | UnsetType = UNSET


class RecordingProgress(Struct, frozen=True):
    """Where recording stands; where it waits for a reward, for what: the answer may have been lost."""

    trajectory: Annotated[int | str | None, _is("Trajectory in progress; null if none.")]
    stage: Annotated[int, _is("Its last, from 1; 0 before the first.")]
    waits_for: Literal["decision", "reward"]
    action: Action | UnsetType = UNSET
    object: Target | UnsetType = UNSET


class EndAnswer(Struct, frozen=True):
    """A trajectory that is over."""

    trajectory: Trajectory
    stages: int
    ending: Literal["finished", "cut"]


class Reloaded(Struct, frozen=True):
    """What answers from now on; in a log, from the next trajectory on."""

    policy: Digest


class StepBacks(Struct):
    """How often the rule decided in the policy's place, since the server began."""

    decisions: Annotated[int, _is("All of them.")]
    stepped_back: Annotated[int, _is("By the rule.")]
    by: Annotated[dict[str, int], _is("The same by its cause.")]
    last: Annotated[str | None, _is("Reason the last time.")]

    def add(self, why: str, detail: str) -> None:
        """Count a decision of the rule."""
        self.stepped_back, self.last = self.stepped_back + 1, detail
        self.by[why] = self.by.get(why, 0) + 1


class Compared(Struct, frozen=True, kw_only=True):
    """How the comparison of the policy with the rule of today stands."""

    sentence: Annotated[str, _is("Summary in words.")]
    verdict: Annotated[Literal["promoted", "stopped", "going on"], _is("Of the policy.")]
    share: Annotated[float, _is("Probability with which the next trajectory is assigned to the policy.")]
    num: Annotated[int, _is("Trajectories that were assigned.")]
    num_policy: Annotated[int, _is("Of these to the policy.")]
    gain: Annotated[Amount, _is("Estimated gain of the policy per trajectory [reward]; null if unknown.")]
    low: Annotated[Amount, _is("Its lower bound, at any time wrong with probability 0.025 at most; null if none.")]
    high: Annotated[Amount, _is("Its upper bound, likewise.")]
    worst_loss: Annotated[Amount, _is("Upper bound on the policy's total loss, wrong with probability 0.05 at most.")]
    most_loss: Annotated[Amount, _is("Total loss above which the policy is stopped; null for no limit.")]
    more: Annotated[int | None, _is("About how many more trajectories would decide; null if unknown.")]
    hidden: Annotated[float, _is("How much of the gain cuts may hide [reward]; the bounds allow for it.")]


class LoggedTrajectory(Struct, frozen=True, kw_only=True):
    """A trajectory of the log."""

    trajectory: Trajectory
    arm: Arm | UnsetType = UNSET
    stages: Annotated[int, _is("That it began.")]
    stepped_back: Annotated[int, _is("Of these, where the rule decided in the policy's place.")]
    reward: Annotated[float, _is("Reward while it was observed.")]
    ending: Literal["finished", "cut"]
    cause: Annotated[str | None, _is("What cut it.")]


class Cell(Struct, frozen=True, kw_only=True):
    """All that the page of the running cell shows but its figures."""

    sentence: Annotated[str, _is("The main facts in words.")]
    revision: Annotated[str, _is("Changes whenever anything except an age changes.")]
    policy: Digest
    decision: Annotated[DecisionAnswer | None, _is("The last one; null before the first.")]
    seen: Annotated[dict[str, Any], _is("Covariates of the decision.")]
    rule: StepBacks
    recording: RecordingProgress | UnsetType = UNSET
    comparison: Compared | UnsetType = UNSET
    trajectories: Annotated[
        list[LoggedTrajectory], _is("The last ones that ended since the server began, the newest first.")
    ]
    monitor: Annotated[
        dict[str, Any] | None,
        _is("Last result of halfseen monitor, age_s ago [s]; null before the first."),
    ]


class Wired(Struct, frozen=True):
    """How the wire to a controller stands."""

    url: Annotated[str, _is("Of the controller.")]
    state: Annotated[
        Literal["Preoperational", "Ready", "ResultReady", "Error"],
        _is("As OPC 40100 calls it: not connected, nothing decided, decided, or a reason not to decide."),
    ]
    error: Annotated[str | None, _is("Why nothing is decided; null if nothing is wrong.")]
    request: Annotated[int | None, _is("Number of the last request; null before the first.")]

    @property
    def is_deciding(self) -> bool:
        """Whether a controller is connected, and nothing is wrong."""
        return self.error is None and self.state != "Preoperational"


class Health(Struct, frozen=True):
    """That a server answers, and what."""

    status: Annotated[
        Literal["ok", "not deciding", "not recording"],
        _is("Not deciding: over the wire. Not recording: the disk could not store the last event."),
    ]
    policy: Digest
    kind: Annotated[str, _is("Of the policy.")]
    rule: StepBacks
    recording: RecordingProgress | UnsetType = UNSET
    comparison: Compared | UnsetType = UNSET
    wire: Wired | UnsetType = UNSET


class Refused(Struct, frozen=True):
    """A request that cannot be answered; the next one can."""

    error: Annotated[str, _is("What is wrong, where, the value and the remedy, in one line.")]


class Refusal(Exception):
    """An HTTP status, and the line of `Refused`."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status, self.answer = status, Refused(" ".join(message.split()))


def model_of(given: Mapping[str, Any], kind: type[Of], *, is_text: bool = False) -> Of:
    """Validate the fields of a request; `is_text` if its numbers are text.

    Raises
    ------
    Refusal
        A field is missing, unknown or invalid.
    """
    try:
        return msgspec.convert(given, kind, strict=not is_text)
    except msgspec.ValidationError as error:
        raise Refusal(422, f"{BODY}: {_trouble(given, kind, str(error))}") from error


def _trouble(given: Mapping[str, Any], kind: type[Struct], error: str) -> str:
    """Error message with the value and the remedy, instead of the message of msgspec."""
    fields = msgspec.json.schema_components([kind])[1][kind.__name__]["properties"]
    if at := re.match("Object contains unknown field `(.*)`$", error, re.DOTALL):
        return f"unknown field {at[1][:40]!r}; give {', '.join(fields)}"
    if at := re.search(r"(?: - at `\$\.|missing required field `)(\w+)[^`]*`$", error):
        wrong = f"{at[1]} is {given[at[1]]!r:.40}" if at[1] in given else f"missing field {at[1]!r}"
        wanted = fields[at[1]]["description"]
        return f"{wrong}; give {wanted[0].lower()}{wanted[1:]}"
    return error
