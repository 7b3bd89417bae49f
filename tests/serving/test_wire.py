"""What a controller asks over the wire is decided once and recorded once, whatever is lost in between.

The controller is played: it holds variables, and a kill is an exception at a moment that the test chooses. Real
sessions are in `test_wire_sessions`.
"""

import asyncio

import numpy as np
import pytest
from asking import refused, written
from starlette.testclient import TestClient

from halfseen.errors import ArgumentError
from halfseen.logs import read_logs
from halfseen.monitoring.dealing import Terms
from halfseen.serving import Answering, LiveComparison, RecordedTrajectories, Served, app_of
from halfseen.serving.models import Wired
from halfseen.serving.opcua.controller import Controller, Snapshot
from halfseen.serving.opcua.mapping import read_mapping, template_of
from halfseen.serving.opcua.wire import REQUESTS_LOST, Wire

URL = "opc.tcp://127.0.0.1:1"
TRAJECTORIES = [
    [({"x1": 0.1, "x2": 1}, 1.0), ({"x1": -0.4, "x2": 0}, 2.0), "finished"],
    [({"x1": 0.3, "x2": 2}, None), "operator"],
    [({"x1": 0.2, "x2": 0}, 0.5), "finished"],
]
"""States and the rewards that follow, and how it ends; a stage that is cut has no reward."""


class Killed(BaseException):
    """The process is gone."""


class Played(Controller):
    """A controller without a network."""

    def __init__(self, killed_at=None, **values):
        self.values = {"request": 0, "decision": 0, "stage": 1, "reward": 0.0, "elapsed_s": 0.0, "ending": ""} | values
        self.doubts, self.written, self.killed_at = {}, [], killed_at

    async def read(self):
        return Snapshot(dict(self.values), dict(self.doubts))

    async def write(self, values):
        if "state" not in values and self.killed_at is not None:
            self.killed_at -= 1
            if self.killed_at == 0:
                raise Killed
        self.written.append(values)
        self.values |= values

    def ask(self, stage, state, **outcome):
        covariates = {f"covariates.{name}": value for name, value in state.items()}
        self.values |= {"stage": stage, **covariates, **outcome, "request": self.values["request"] + 1}


def asking(**more):
    """A controller with its first request."""
    controller = Played()
    controller.ask(1, {"x1": 0.1, "x2": 1}, **more)
    return controller


class Side:
    """Halfseen's side, which may be killed and begun again on the same log."""

    def __init__(self, policy, folder, *, is_compared=False, epsilon=0.5):
        self.policy, self.folder, self.is_compared, self.epsilon = policy, folder, is_compared, epsilon
        self.lines, self.num_begun = [], 0
        self.begin()

    def begin(self):
        self.num_begun += 1
        self.trajectories = RecordedTrajectories(self.folder / "logs", resumes=True)
        served = Served(self.policy, limit_s=None)
        (self.folder / "cell.toml").write_text(template_of(served.service.stored))
        comparison = None
        if self.is_compared:
            (self.folder / "rule.csv").write_text("action\nA\n")
            terms = Terms(0.5)
            comparison = LiveComparison(served.service, self.folder / "rule.csv", self.folder / "logs", terms)
        rng = np.random.default_rng(self.num_begun)
        served.answering = Answering(self.epsilon, None, rng, self.trajectories, comparison=comparison)
        mapping = read_mapping(self.folder / "cell.toml", served.service.stored)
        self.wire = Wire(served, URL, mapping, tell=self.lines.append)
        self.wire.resume()

    def begin_again(self):
        self.leave()
        self.begin()

    def leave(self):
        self.trajectories.__exit__(None, None, None)

    def look(self, controller):
        asyncio.run(self.wire.look(controller))
        return self.wire.facts

    def logs(self):
        return read_logs(self.folder / "logs")


@pytest.fixture
def side(flat, tmp_path):
    made = Side(flat, tmp_path)
    yield made
    made.leave()


def run(side, controller, trajectories=TRAJECTORIES):
    """Let the controller run; what it did by the number of the request, each once."""
    did = {}

    def answered():
        while controller.values["decision"] != controller.values["request"]:
            try:
                side.look(controller)
            except Killed:
                side.begin_again()

    for *stages, ending in trajectories:
        outcome = {}
        for k, (state, reward) in enumerate(stages, start=1):
            controller.ask(k, state, ending="", **outcome)
            answered()
            assert controller.values["request"] not in did
            did[controller.values["request"]] = (controller.values["action"], state["x1"], reward)
            outcome = {"reward": np.nan if reward is None else reward, "elapsed_s": 2.0 * k}
        controller.ask(len(stages) + 1, stages[-1][0], ending=ending, **outcome)
        answered()
    return did


def check(side, did):
    """The log has each decision once, as the controller did it."""
    logs = side.logs()
    stages = logs.stages.merge(logs.trajectories, on="trajectory")
    numbers = (stages["first_request"] + stages["stage"] - 1).tolist()
    rewards = [None if np.isnan(reward) else reward for reward in stages["reward"]]
    assert dict(zip(numbers, zip(stages["action"], stages["x1"], rewards, strict=True), strict=True)) == did
    assert len(numbers) == len(did)
    assert logs.trajectories["ending"].tolist() == ["finished", "cut", "finished"]
    assert logs.trajectories["cause"].tolist()[1] == "operator"
    assert logs.trajectories["end_s"].tolist() == [4.0, 2.0, 2.0]


@pytest.mark.parametrize(
    ("killed_at", "is_compared"),
    [*((at, False) for at in (None, *range(1, 12))), *((at, True) for at in (None, 2, 3, 6))],
)
def test_a_kill_before_any_writing_loses_nothing_and_decides_nothing_twice(flat, tmp_path, killed_at, is_compared):
    side = Side(flat, tmp_path, is_compared=is_compared)
    did = run(side, Played(killed_at))
    side.leave()
    assert side.num_begun == 1 + (killed_at is not None)
    check(side, did)


@pytest.mark.parametrize("name", ["decide", "ended"])
@pytest.mark.parametrize("killed_at", [1, 2, 3])
def test_nor_does_a_kill_between_two_lines_of_the_log(flat, tmp_path, monkeypatch, name, killed_at):
    known, calls = getattr(Served, name), []

    def killed(self, *given):
        calls.append(given)
        if len(calls) == killed_at:
            raise Killed
        return known(self, *given)

    monkeypatch.setattr(Served, name, killed)
    side = Side(flat, tmp_path)
    did = run(side, Played())
    side.leave()
    assert side.num_begun == 2
    check(side, did)


def test_the_action_is_there_before_its_number_and_how_it_stands_is_reported(side):
    controller = Played()
    assert side.look(controller).state == "Ready"
    controller.ask(1, {"x1": 0.1, "x2": 1})
    facts = side.look(controller)
    assert (facts.url, facts.state, facts.error, facts.request) == (URL, "ResultReady", None, 1)
    answers = [values for values in controller.written if "state" not in values]
    assert [*map(list, answers)] == [["action"], ["decision"]]
    assert controller.values["state"] == "ResultReady"
    num_written = len(controller.written)
    side.look(controller)
    assert len(controller.written) == num_written


@pytest.mark.parametrize(
    ("doubts", "values", "message"),
    [
        ({"covariates.x1": "has the quality BadSensorFailure"}, {}, "x1 has the quality BadSensorFailure"),
        ({"covariates.x2": "is 7 s old, and 2 s are allowed"}, {}, "x2 is 7 s old, and 2 s are allowed"),
        ({}, {"covariates.x1": float("nan")}, "x1"),
        ({}, {"covariates.x1": "left"}, "x1"),
        ({}, {"covariates.x1": None}, "x1"),
        ({}, {"stage": 2}, "stage is 2, but the log expects stage 1; end the trajectory"),
        ({}, {"stage": -1}, "stage is -1, not a whole number from 0"),
        ({"request": "has the quality Bad"}, {}, "request has the quality Bad"),
        ({}, {"request": 1.5}, "request is 1.5, not a whole number from 0"),
        ({}, {"ending": 1}, 'ending is 1, not text; give "", "finished", or what cut the trajectory'),
    ],
)
def test_what_is_doubtful_is_not_acted_on_until_it_is_good_and_both_are_reported_once(side, doubts, values, message):
    controller = asking()
    good, controller.values, controller.doubts = controller.values, {**controller.values, **values}, doubts
    for _ in range(2):
        facts = side.look(controller)
        assert facts.state == controller.values["state"] == "Error"
        assert message in facts.error
        assert controller.values["error"] == facts.error
    assert side.lines == [f"{URL}: no decision is written: {facts.error}"]
    assert all("state" in written for written in controller.written)
    controller.values, controller.doubts = good, {}
    assert side.look(controller).state == "ResultReady"
    assert side.lines[1:] == [f"{URL}: decisions are written again"]
    assert controller.values["decision"] == 1


@pytest.mark.parametrize("ending", ["Finished", "FINISHED", " finished "])
def test_a_trajectory_that_finished_in_other_letters_is_not_cut(side, ending):
    controller = asking(ending=" ")
    side.look(controller)
    controller.ask(2, {"x1": 0.1, "x2": 1}, ending=ending, reward=1.5, elapsed_s=2.0)
    assert side.look(controller).state == "Ready"
    side.leave()
    assert side.logs().trajectories["ending"].tolist() == ["finished"]
    assert side.logs().stages["reward"].tolist() == [1.5]


@pytest.mark.parametrize(
    ("outcome", "doubts"),
    [
        ({"reward": np.nan}, {}),
        ({"reward": 1.0, "elapsed_s": 0.0}, {}),
        ({"reward": 1.0}, {"reward": "has the quality Bad"}),
    ],
)
def test_a_reward_that_is_none_is_not_recorded(side, outcome, doubts):
    controller = asking()
    side.look(controller)
    controller.ask(2, {"x1": 0.1, "x2": 1}, **{"elapsed_s": 2.0, **outcome})
    controller.doubts = doubts
    assert side.look(controller).state == "Error"
    assert controller.values["decision"] == 1
    controller.values |= {"reward": 1.0, "elapsed_s": 2.0}
    controller.doubts = {}
    assert side.look(controller).state == "ResultReady"


def test_a_trajectory_whose_clock_went_back_can_be_cut(side):
    controller, state = asking(), {"x1": 0.1, "x2": 1}
    side.look(controller)
    controller.ask(2, state, reward=1.0, elapsed_s=5.0)
    side.look(controller)
    controller.ask(3, state, reward=1.0, elapsed_s=3.0)
    assert "elapsed_s 3.0 is before the 5.0" in side.look(controller).error
    for ending, facts in (("finished", "Error"), ("operator", "Ready")):
        controller.values["ending"] = ending
        assert side.look(controller).state == facts
    controller.ask(1, state, ending="")
    assert side.look(controller).state == "ResultReady"
    side.leave()
    assert side.logs().trajectories["cause"][0] == "operator"
    assert side.logs().trajectories["end_s"][0] == 5.0


def test_a_controller_that_lost_its_numbers_begins_a_trajectory_and_the_one_before_is_cut(side):
    controller, state = Played(request=40), {"x1": 0.1, "x2": 1}
    controller.ask(1, state)
    side.look(controller)
    for changed in ({"request": 0}, {"request": 40, "covariates.x1": 0.2}):
        controller.values |= {"decision": 0} | changed
        controller.ask(1, {**state, "x1": controller.values["covariates.x1"]})
        side.look(controller)
        assert controller.values["decision"] == controller.values["request"]
    controller.ask(4, state)
    assert side.look(controller).error == "stage is 4, but the log expects stage 1; end the trajectory"
    controller.values |= {"ending": "time-out"}
    assert side.look(controller).state == "Ready"
    side.leave()
    logs = side.logs()
    assert logs.trajectories["first_request"].tolist() == [41, 1, 41]
    assert set(logs.trajectories["cause"]) == {REQUESTS_LOST}


def test_a_second_halfseen_that_answers_the_same_controller_is_reported(side):
    controller, state = Played(request=40, decision=40), {"x1": 0.1, "x2": 1}
    assert side.look(controller).error is None
    controller.ask(1, state)
    assert side.look(controller).state == "ResultReady"
    for _ in range(2):
        controller.ask(2, state)
        controller.values["decision"] = controller.values["request"]
        assert "answered by somebody else" in side.look(controller).error
    assert len(side.lines) == 1
    controller.values |= {"request": 7, "decision": 7}
    assert side.look(controller).error is None


@pytest.mark.parametrize("is_compared", [False, True])
def test_a_trajectory_is_cut_where_a_comparison_begins_or_ends_within_it(flat, tmp_path, is_compared):
    side = Side(flat, tmp_path, is_compared=is_compared)
    controller = asking()
    side.look(controller)
    side.is_compared = not is_compared
    side.begin_again()
    side.leave()
    assert side.logs().trajectories["cause"].tolist() == [REQUESTS_LOST]


def test_a_trajectory_that_another_policy_began_is_cut_at_a_restart(flat, tmp_path):
    side = Side(flat, tmp_path)
    side.look(asking())
    side.policy = written(tmp_path / "other", reg=5.0)
    side.begin_again()
    side.leave()
    assert side.logs().trajectories["cause"].tolist() == [REQUESTS_LOST]


def test_what_goes_wrong_in_halfseen_is_reported_and_the_wire_stays(side, monkeypatch, capsys):
    controller = asking()

    async def broken(look):
        raise ZeroDivisionError

    with monkeypatch.context() as patched:
        patched.setattr(side.wire.served, "decide", broken)
        assert side.look(controller).error == "unexpected error in halfseen (ZeroDivisionError)"
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert side.look(controller).state == "ResultReady"


def test_http_tells_how_the_wire_stands_and_decides_nothing_beside_it(side):
    with TestClient(app_of(side.wire.served, wire=side.wire), base_url="http://127.0.0.1") as client:
        for path in ("/decide", "/reward", "/end"):
            assert "the controller at opc.tcp://" in refused(client.post(path, json={}), 409)
        answer = client.get("/health").json()
        assert client.get("/openapi.json").status_code == 200
    assert (answer["wire"]["url"], answer["wire"]["state"], answer["status"]) == (URL, "Preoperational", "not deciding")


@pytest.mark.parametrize(
    ("state", "error", "status"),
    [("Ready", None, "ok"), ("ResultReady", None, "ok"), ("Error", "views is bad", "not deciding")],
)
def test_health_is_ok_while_the_wire_is(side, state, error, status):
    side.wire.facts = Wired(URL, state, error, 1)
    client = TestClient(app_of(side.wire.served, wire=side.wire), base_url="http://127.0.0.1")
    assert client.get("/health").json()["status"] == status


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[reads]", "[reads]\nrobot = 'R'"), "reads.robot: it is unknown"),
        (("stage =", "# stage ="), "reads.stage: it is missing"),
        (('x1 = "Cell/x1"\n', ""), "covariates: 'x1' of the policy is missing; add it"),
        (("# [actions]\n#", "[actions]\n"), "actions: 'B' of the policy is missing; add it"),
        (("# [actions]\n#", "[actions]\nB = 0\nC = 1\n"), "actions: two of them have the same code"),
        (("# [actions]\n#", "[actions]\nB = 1\nC = 2\nAA = 3\n"), "no 'AA'; did you mean 'A'?"),
        (("stale_after_s = 2.0", "stale_after_s = 0"), "stale_after_s:"),
        (("[namespaces]", "[namespaces"), "it is not valid TOML"),
        (
            ("# [security]\n# mode", '[security]\nkey = "k"\ncertificate = "c"\n"server_certificate" = "s"\nmode'),
            "no such file",
        ),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused_in_one_line(flat, tmp_path, change, message):
    stored, file = Served(flat).service.stored, tmp_path / "cell.toml"
    text = template_of(stored)
    assert text.count(change[0]) == 1
    file.write_text(text.replace(*change))
    with pytest.raises(ArgumentError) as refusal:
        read_mapping(file, stored)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_template_is_a_mapping_and_names_have_namespaces(flat, tmp_path):
    stored, file = Served(flat).service.stored, tmp_path / "cell.toml"
    file.write_text(template_of(stored).replace("[namespaces]", '[namespaces]\nvision = "urn:vision"'))
    mapping = read_mapping(file, stored)
    assert mapping.covariates == {"x1": "Cell/x1", "x2": "Cell/x2"}
    first, other = "urn:vision", "urn:example:cell"
    assert mapping.browse_names("cell:Cell/2:x/a") == [(other, "Cell"), (first, "2:x"), (first, "a")]
