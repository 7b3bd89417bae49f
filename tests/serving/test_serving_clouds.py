"""A trajectory that is served from clouds: gone on with as `act` does, and recorded as it was decided."""

import asyncio
import json
import shlex
import shutil
import threading
from dataclasses import asdict
from functools import cache
from itertools import count, pairwise
from pathlib import Path

import httpx2
import numpy as np
import pytest
from asking import client_of, refused
from click.testing import CliRunner

from drawn_tables import EYE_M, Can, draw
from halfseen.arrays import mapped
from halfseen.cli.act import act
from halfseen.cli.inputs import law_of
from halfseen.evaluation import evaluate
from halfseen.learning import CensoredQLearner
from halfseen.logs import read_logs
from halfseen.logs.data_quality import data_warnings
from halfseen.perception import perceive, read_cloud
from halfseen.perception.pcd import write_pcd
from halfseen.policies import decider_of, read_policy, table_observation
from halfseen.policies.folder import write_policy
from halfseen.policies.table_observation import Past, see_table
from halfseen.serving.app import app_of
from halfseen.serving.models import RecordingProgress
from halfseen.serving.recording import RecordedTrajectories
from halfseen.serving.served import Answering, Served
from halfseen.world.logs import states_of

# The middle one hides the last in part.
CANS = LEFT, MIDDLE, BEHIND = Can(-0.12, 0.05), Can(0.02, 0.0), Can(0.05, 0.14)
ELSEWHERE = Can(-0.3, -0.25)
HORIZON = 4


@pytest.fixture(autouse=True)
def _each_cloud_is_looked_at_once(monkeypatch):
    of_bytes = cache(lambda data, file: read_cloud(file))
    monkeypatch.setattr(table_observation, "read_cloud", lambda file: of_bytes(file.read_bytes(), file))
    monkeypatch.setattr(table_observation, "perceive", once)


once = cache(perceive)


@cache
def drawn(*cans):
    return draw(*cans)


@pytest.fixture
def shows(tmp_path):
    """Make the bytes of a cloud that shows cans."""
    number = count()

    def cloud(*cans):
        file = tmp_path / f"drawn-{next(number)}.pcd"
        write_pcd(drawn(*cans).cloud, file)
        return file.read_bytes()

    return cloud


@pytest.fixture
def recorded(tables, tmp_path):
    with client_of(tables, tmp_path / "logs", of_tables=True) as client:
        yield client


def post(client, cloud, labels="", **fields):
    files = {"cloud": ("t.pcd", cloud)} | ({"labels": ("l.csv", labels.encode())} if labels else {})
    return client.post("/decide", files=files, data=fields)


def decided(client, cloud, labels="", **fields):
    answer = post(client, cloud, labels, **fields)
    assert answer.status_code == 200, answer.text
    return answer.json()


def rewarded(client, **result):
    answer = client.post("/reward", json={"reward": 1.0} | result)
    assert answer.status_code == 200, answer.text
    return answer.json()


def labels_of(rng, num_objects):
    words = rng.choice(["dirty", "clean", "unknown"], num_objects)
    return "".join(["object,label\n", *(f"{number},{word}\n" for number, word in enumerate(words))])


def last_rows(logs):
    trajectory = logs.select(logs.trajectory_ids[-1:])
    return trajectory.objects[trajectory.objects["stage"] == trajectory.horizon].reset_index(drop=True)


def can_at(row):
    """Which can stands where an object was seen: the camera's foot is not where cans are counted from."""
    apart_m = [np.hypot(row["x_m"] - can.x_m, row["y_m"] + EYE_M[1] - can.y_m) for can in (*CANS, ELSEWHERE)]
    assert min(apart_m) < 0.01
    return (*CANS, ELSEWHERE)[int(np.argmin(apart_m))]


def checked_stage(logs, seen, result):
    """What is recorded of a stage is the state that it was decided in, to the last bit; returns its rows."""
    rows, stage, now = last_rows(logs), seen.present.stage, seen.present.state
    places_m = rows[["x_m", "y_m", "z_m"]].to_numpy()
    name_of = [int(np.flatnonzero((places_m == place_m).all(axis=1))[0]) for place_m in seen.view.places_m]
    state = mapped(lambda leaf: leaf[0, stage - 1], states_of(logs, HORIZON))
    assert np.flatnonzero(state.is_on_table).tolist() == sorted(name_of)
    for name in ("grip", "log_odds", "seen", "lifts"):
        np.testing.assert_array_equal(np.asarray(getattr(state, name))[name_of], getattr(now, name))
    np.testing.assert_array_equal(np.asarray(state.hides)[np.ix_(name_of, name_of)], now.hides)
    assert int(state.steps_to_go) == int(now.steps_to_go)
    number = result["action"].partition(" ")[2]
    assert result["object"] == (name_of[int(number)] if number else None)
    done = logs.stages.iloc[-1]
    assert (done["action"], done["probability"]) == (result["verb"], result["probability"])
    return rows


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_what_is_recorded_is_what_was_decided_in(tables, shows, tmp_path, seed):
    """Stage by stage: the state by the log before and the cloud, the decision, the log after, and a naive account."""
    stored, rng, folder, file = read_policy(tables), np.random.default_rng(seed), tmp_path / "logs", tmp_path / "t.pcd"
    decider, labels = decider_of(stored, extrapolates=True), tmp_path / "l.csv"
    table, held, tried, lifted = list(CANS), None, {can: [] for can in CANS}, dict.fromkeys(CANS, 0)
    with client_of(tables, folder, of_tables=True, epsilon=0.9, rng=rng) as client:
        for stage in range(1, HORIZON + 1):
            file.write_bytes(shows(*table))
            labels.write_text(labels_of(rng, len(table)))
            past = None if stage == 1 else Past(read_logs(folder), held)
            seen = see_table(stored, file, past, labels=labels)
            said = json.loads(json.dumps(asdict(decider.decide(seen.present))))
            of_labels = decided(client, file.read_bytes(), labels.read_text())
            assert all(of_labels[name] == said[name] for name in ("q_values", "intervals", "chance_best"))
            assert of_labels["seen"] == seen.present.seen.replace(str(labels), "labels.csv")
            rows = checked_stage(read_logs(folder), seen, of_labels)
            for _, row in rows.iterrows():
                can, outcomes = can_at(row), [outcome for _, outcome in tried[can_at(row)]]
                assert row["location"] == ("TABLE" if can in table else "DISHWASHER")
                assert row["attempt_succeeded"].tolist() == outcomes
                np.testing.assert_allclose(
                    row["attempt_occlusions"].tolist(), [share for share, _ in tried[can]], atol=1e-6
                )
                assert (row["successes"], row["failures"]) == (outcomes.count(True), outcomes.count(False))
                assert row["lifts"] == lifted[can]
            if of_labels["verb"] == "FINISH":
                break
            target, held = rows.iloc[of_labels["object"]], bool(rng.random() < 0.6)
            rewarded(client, held=held)
            can = can_at(target)
            tried[can].append((target["occlusion"], held))
            lifted[can] += of_labels["verb"] == "LIFT" and held
            if of_labels["verb"] == "WASH" and held:
                table.remove(can)
            if not table:
                break


@pytest.mark.slow
def test_where_nobody_says_what_held_it_is_taken_as_act_takes_it(recorded, tables, shows, tmp_path):
    table, folder, done = list(CANS), tmp_path / "logs", ""
    for stage in range(1, HORIZON + 1):
        cloud = shows(*table)
        (tmp_path / "t.pcd").write_bytes(cloud)
        history = [] if stage == 1 else ["--history", str(folder)]
        words = [str(tables), str(tmp_path / "t.pcd"), "--json", "--extrapolate", *history]
        said = json.loads(CliRunner().invoke(act, words, catch_exceptions=False).output)
        answer = decided(recorded, cloud, stage=str(stage))
        for name in ("stage", "q_values", "intervals", "chance_best", "warnings"):
            assert answer[name] == said[name]
        if done == "LIFT":
            assert "held is not known; it is not counted" in answer["warnings"][0]
        done = answer["verb"]
        if done == "FINISH":
            break
        if done == "WASH":
            table.remove(can_at(last_rows(read_logs(folder)).iloc[answer["object"]]))
        rewarded(recorded)
        if not table:
            break


@pytest.mark.slow
def test_what_a_law_tells_of_looks_is_recorded(tables, shows, tmp_path):
    folder, law, labels = tmp_path / "logs", law_of("shipped"), "object,label\n0,dirty\n1,clean\n2,dirty\n"
    (tmp_path / "t.pcd").write_bytes(shows(*CANS))
    (tmp_path / "l.csv").write_text(labels)
    with client_of(tables, folder, of_tables=True, law=law) as client:
        for stage in (1, 2):
            past = None if stage == 1 else Past(read_logs(folder), held=False)
            seen = see_table(read_policy(tables), tmp_path / "t.pcd", past, labels=tmp_path / "l.csv", law=law)
            of_labels = decided(client, shows(*CANS), labels)
            rows = checked_stage(read_logs(folder), seen, of_labels)
            assert (rows["seen"] > 0.0).all()
            rewarded(client, held=False)
    first, again = (read_logs(folder).objects.groupby("stage")["log_odds"].get_group(stage) for stage in (1, 2))
    # The same look once more is no news.
    np.testing.assert_allclose(first, again, atol=1e-6)


@pytest.mark.slow
def test_what_comes_into_view_has_a_name_of_its_own_and_keeps_it(recorded, shows, tmp_path):
    names = []
    for table in ([LEFT, MIDDLE], [LEFT, ELSEWHERE, MIDDLE], [ELSEWHERE, MIDDLE], CANS):
        answer = decided(recorded, shows(*table))
        rows = last_rows(read_logs(tmp_path / "logs"))
        names.append({can_at(row): row["object"] for _, row in rows.iterrows()})
        assert rows["location"].tolist() == ["TABLE"] * len(rows)
        if answer["verb"] == "FINISH":
            pytest.fail("the seed of the fixture lets no trajectory end here")
        rewarded(recorded, held=False)
    assert [len(each) for each in names] == [2, 3, 3, 4]
    assert all(before.items() <= after.items() for before, after in pairwise(names))
    assert sorted(names[-1].values()) == [0, 1, 2, 3]
    assert "which the cloud does not show" in answer["warnings"][0]


def test_what_cannot_be_gone_on_from_leaves_the_trajectory_as_it_was(recorded, shows, tmp_path):
    def journal():
        return {file.name: file.read_bytes() for file in sorted((tmp_path / "logs").iterdir())}

    cloud, bare = shows(*CANS), [{"object": 0, "location": "TABLE"}]
    decided(recorded, cloud)
    waits = journal()
    assert "trajectory 1, stage 1: it has no reward yet" in refused(post(recorded, cloud), 409)
    assert journal() == waits
    rewarded(recorded, held=False)
    before, where = journal(), recorded.get("/health").json()
    assert "stage is 1, but the trajectory in progress is at stage 2" in refused(post(recorded, cloud, stage="1"), 409)
    assert "it came as a cloud, but now JSON" in refused(recorded.post("/decide", json={"objects": bare}), 409)
    assert refused(post(recorded, b"VERSION .7\n"), 422).startswith("cloud.pcd: ")
    assert "if it is cleared, the trajectory is over" in refused(post(recorded, shows()), 422)
    assert "of another table" in refused(post(recorded, shows(ELSEWHERE)), 422)
    assert "labels.csv: object 0 of 3" in refused(post(recorded, cloud, "object,label\n"), 422)
    assert (journal(), recorded.get("/health").json()) == (before, where)
    assert decided(recorded, cloud)["stage"] == 2


def test_names_and_columns_that_a_folder_has_not_are_refused(recorded, shows, tmp_path):
    row = {"location": "TABLE", "occlusion": 0.0, "log_odds": 0.1, "lifts": 0, "hidden_by": [0.0]}
    objects = [{"object": "mug", **row, "attempt_occlusions": [], "attempt_succeeded": []}]
    assert recorded.post("/decide", json={"objects": objects}).status_code == 200
    assert "held is for clouds" in refused(recorded.post("/reward", json={"reward": 1, "held": True}), 422)
    rewarded(recorded)
    assert "it came as JSON, but now a cloud" in refused(post(recorded, shows(*CANS)), 409)
    # A name that is gone makes a log that nobody reads.
    other = [{**objects[0], "object": "cup"}]
    assert "no longer lists it" in refused(recorded.post("/decide", json={"objects": other}), 422)
    recorded.post("/end", json={"ending": "cut", "cause": "operator"})
    assert "object 0 is a number, but earlier ones are text" in refused(post(recorded, shows(*CANS)), 422)
    assert recorded.get("/health").json()["recording"]["trajectory"] is None
    assert recorded.post("/decide", json={"objects": objects}).json()["trajectory"] == 2
    assert read_logs(tmp_path / "logs").num_trajectories == 2


def test_the_log_is_there_whenever_the_server_is_killed(recorded, shows, tmp_path):
    def left():
        shutil.copytree(tmp_path / "logs", tmp_path / "left", dirs_exist_ok=True)
        return read_logs(tmp_path / "left")

    for stage in (1, 2):
        decided(recorded, shows(*CANS))
        assert left().stages["stage"].tolist() == list(range(1, stage + 1))
        rewarded(recorded, held=False)
        assert left().trajectories["cause"].tolist() == ["crash"]
    assert len(left().objects) == 6


def test_others_are_answered_while_a_cloud_is_looked_at_and_the_order_stays(tables, shows, tmp_path, monkeypatch):
    may_go_on, is_looking = threading.Event(), threading.Event()

    def slowly(cloud):
        is_looking.set()
        assert may_go_on.wait(30)
        return once(cloud)

    async def ask(app, cloud):
        async with httpx2.AsyncClient(transport=httpx2.ASGITransport(app), base_url="http://localhost") as client:
            files = {"cloud": ("t.pcd", cloud)}
            decision = asyncio.create_task(client.post("/decide", files=files))
            while not is_looking.is_set():
                await asyncio.sleep(0.01)
            reward = asyncio.create_task(client.post("/reward", json={"reward": 1.0}))
            health = (await client.get("/health")).json()
            may_go_on.set()
            return health, (await decision).json(), (await reward).json()

    monkeypatch.setattr(table_observation, "perceive", slowly)
    with RecordedTrajectories(tmp_path / "logs", is_of_tables=True) as trajectories:
        served = Served(tables, Answering(trajectories=trajectories), extrapolates=True)
        health, answer, rewarded = asyncio.run(ask(app_of(served), shows(*CANS)))
    assert health["recording"] == {"trajectory": None, "stage": 0, "waits_for": "decision"}
    assert answer["stage"] == 1
    assert rewarded == {"trajectory": 1, "stage": 1, "waits_for": "decision"}


def test_nothing_is_decided_for_a_client_that_has_gone(tables, shows, tmp_path, monkeypatch):
    has_gone, sent = threading.Event(), []

    def hung_up(cloud):
        has_gone.set()
        return once(cloud)

    request = httpx2.Request("POST", "http://localhost/decide", files={"cloud": ("t.pcd", shows(*CANS))})
    messages = [{"type": "http.request", "body": request.read(), "more_body": False}]

    async def receive():
        if messages:
            return messages.pop()
        while not has_gone.is_set():
            await asyncio.sleep(0.01)
        return {"type": "http.disconnect"}

    async def send(message):
        sent.append(message)

    headers = [(name.lower().encode(), value.encode()) for name, value in request.headers.items()]
    scope = {"type": "http", "method": "POST", "path": "/decide", "query_string": b"", "headers": headers}
    monkeypatch.setattr(table_observation, "perceive", hung_up)
    with RecordedTrajectories(tmp_path / "logs", is_of_tables=True) as trajectories:
        app = app_of(Served(tables, Answering(trajectories=trajectories), extrapolates=True))
        asyncio.run(app(scope, receive, send))
        assert trajectories.facts == RecordingProgress(None, 0, "decision")
    assert b"the client has disconnected" in sent[-1]["body"]


@pytest.mark.slow
def test_what_was_served_from_clouds_makes_the_next_log(tables, shows, tmp_path):
    rng, folder = np.random.default_rng(2), tmp_path / "logs"
    clouds, cans = {k: shows(*CANS[:k]) for k in (2, 3)}, None
    with client_of(tables, folder, of_tables=True, epsilon=0.5, rng=rng) as client:
        for trajectory in range(30):
            num_left = len(CANS)
            for _ in range(2):
                labels = decided(client, clouds[num_left], labels_of(rng, num_left))
                cans = cans or [can_at(row) for _, row in last_rows(read_logs(folder)).iterrows()]
                if labels["verb"] == "FINISH":
                    rewarded(client, reward=-2.0 * num_left)
                    break
                held = labels["verb"] == "WASH" and cans[labels["object"]] is CANS[num_left - 1]
                rewarded(client, reward=float(rng.normal()), held=held)
                num_left -= held
            client.post(
                "/end", json={"ending": "cut", "cause": "operator"} if trajectory % 5 == 4 else {"ending": "finished"}
            )
    logs = read_logs(folder)
    assert (logs.num_trajectories, int(logs.is_finished.sum())) == (30, 24)
    assert data_warnings(logs) == ()
    learner = CensoredQLearner.for_table(HORIZON, reg=0.1).fit(logs)
    write_policy(learner, logs, tmp_path / "next")
    (prior,) = logs.trajectories["dirty_share"].unique()
    assert read_policy(tmp_path / "next").record["schema"]["dirty_share"] == prior
    labels = evaluate(learner.policy_, logs, against="logging", censoring="kaplan-meier", num_folds=2)
    assert np.isfinite(labels.doubly_robust.value)


def test_the_path_of_the_guide_is_answered_and_recorded(recorded, shows, tmp_path):
    guide = (Path(__file__).parents[2] / "docs" / "guide" / "from-logs-to-a-policy.md").read_text(encoding="utf-8")
    block = next(part for part in guide.split("```") if "cloud=@first-look.pcd" in part)
    files = {"first-look.pcd": shows(*CANS), "second-look.pcd": shows(LEFT, BEHIND)}
    for line in block.splitlines()[1:]:
        words = shlex.split(line)
        given = [after for word, after in pairwise(words) if word in ("-F", "-d")]
        address = words[-1].removeprefix("http://127.0.0.1:8080")
        if words[1] == "-F":
            names = dict(one.split("=@") for one in given)
            labels = ["object,label", "0,dirty", "1,dirty", "2,dirty"][: 4 if "first" in line else 3]
            answer = post(recorded, files[names["cloud"]], "\n".join(labels))
        else:
            answer = recorded.post(address, content=given[0], headers={"content-type": "application/json"})
        assert answer.status_code == 200, f"{line}: {answer.text}"
    stages = read_logs(tmp_path / "logs").stages
    assert stages["reward"].tolist() == [4.6, -0.4]


@pytest.mark.slow
def test_beyond_the_horizon_the_trajectory_ends_and_is_recorded(recorded, tables, shows, tmp_path):
    cloud = shows(*CANS)
    for stage in range(1, HORIZON + 1):
        assert "stepped_back" not in decided(recorded, cloud, stage=str(stage))
        rewarded(recorded)
    answer = decided(recorded, cloud)
    assert (answer["stage"], answer["action"], answer["stepped_back"]) == (HORIZON + 1, "FINISH", "beyond-horizon")
    rewarded(recorded)
    recorded.post("/end", json={"ending": "finished"})
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["stepped_back"].notna().tolist() == [False] * HORIZON + [True]
    assert len(last_rows(logs)) == len(CANS)
    with client_of(tables, of_tables=True) as alone:
        assert decided(alone, cloud, stage=str(HORIZON + 5))["stepped_back"] == "beyond-horizon"
        assert "from 1 to 10,000" in refused(post(alone, cloud, stage="99999999"), 422)
