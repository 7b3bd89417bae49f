"""``halfseen act`` and ``halfseen export``: a decision, its reason, and the policy as ONNX."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import onnxruntime
import pandas as pd
import pytest
import shell

from drawn_tables import Can, boxes_cloud, draw
from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.perception import perceive, read_cloud, write_pcd
from halfseen.policies import read_policy
from halfseen.policies.table_observation import past_in, see_table
from halfseen.scene import table_paths
from halfseen.world import TableWorld, UniformPolicy, WorldConfig
from halfseen.world.seeing import label_evidence
from small_logs import begun_log, flat_learner, flat_log, kept

TABLE = table_paths()[7]
FLAT = flat_log()
DULL = f"its log: covariate colour is 'red' in all {FLAT.num_stages} rows: a dead sensor, or a column to leave out"


def run(*words):
    return shell.run("act", *words).output


def report_of(*words):
    return shell.report("act", *words)


@pytest.fixture
def flat(house):
    return house / "policy"


@pytest.fixture
def tables(house):
    return house / "table-policy"


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    folder = tmp_path_factory.mktemp("act") / "history"
    begun_log(perceive(read_cloud(TABLE)).scene()).write(folder)
    return folder


def state(folder, name="state.json", text='{"x1": 0.4, "x2": 1}'):
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.slow
def test_a_decision_on_named_actions_loads_no_compiler_and_no_perception(flat, tmp_path):
    words = ["act", str(flat), str(state(tmp_path)), "--stage", "1"]
    code = "import sys\nfrom halfseen.cli import main\nmain()\nprint(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True).stdout
    heavy = {"jax", "scipy", "sklearn", "matplotlib", "halfseen.perception.view"}
    assert set(said.splitlines()[-1].split()) & heavy == set()


def test_named_actions_are_decided_as_the_learner_does(flat, tmp_path):
    learner = read_policy(flat).policy
    for stage, x1 in ((1, 0.4), (1, -0.9), (2, 0.3)):
        report = report_of(flat, state(tmp_path, text=f'{{"x1": {x1}, "x2": 1, "stage": {stage}}}'))
        row = pd.DataFrame({"x1": [x1], "x2": [1]})
        assert report["action"] == learner.decide(row, stage)[0]
        q = dict(zip("ABC", learner.q_values(row, stage)[0].tolist(), strict=True))
        assert report["q_values"] == {**q, ("C" if stage == 1 else "B"): None}
        assert report["reason"].startswith(f"{report['action']}: worth ")
        assert (report["stage"], report["horizon"], report["warnings"]) == (stage, 2, [DULL])


def test_csv_and_json_say_the_same_and_people_get_the_reason_first(flat, tmp_path):
    as_json = run(flat, state(tmp_path), "--stage", 2)
    assert run(flat, state(tmp_path, "s.csv", "x2,x1\n1,0.4\n"), "--stage", 2) == as_json
    lines = as_json.splitlines()
    assert lines[0].startswith(("A: worth ", "C: worth "))
    assert lines[1:4] == [f"warning: {DULL}", "", "stage 2 of 2"]
    assert [line.split()[0] for line in lines[5:-1]] in (["A", "C", "The"], ["C", "A", "The"])
    assert lines[-2].startswith("The uncertainty is unknown: the policy was learned without pessimism")
    assert lines[5].split()[0] == lines[0][0]
    far = state(tmp_path, text='{"x1": 800, "x2": 1}')
    assert "warning: x1 is 800, outside the logs (" in run(flat, far, "--extrapolate")


def test_that_nothing_speaks_for_the_policy_is_reported_at_each_decision(tmp_path):
    verdict = {"verdict": "not better", "reason": "it earns 2 less a trajectory than b, between -3 and -1 more"}
    kept(flat_learner(), FLAT, tmp_path / "p", verdict=verdict | {"sentence": "Not better: …."})
    labels = f"no evidence that this policy beats the rule that made the logs: {verdict['reason']}"
    assert run(tmp_path / "p", state(tmp_path)).splitlines()[1] == f"warning: {labels}"
    assert report_of(tmp_path / "p", state(tmp_path))["warnings"] == [labels, DULL]


def test_a_table_is_decided_from_its_cloud(tables):
    report = report_of(tables, TABLE)
    assert list(report["intervals"]) == list(report["chance_best"]) == list(report["q_values"])
    assert list(report["q_values"]) == ["FINISH", *(f"{verb} {k}" for verb in ("WASH", "LIFT") for k in range(5))]
    assert report["action"] == max(report["q_values"], key=report["q_values"].get)
    assert report["reason"].startswith(f"{report['action']}: worth ")
    assert report["warnings"][0] == "num_objects is 5, outside the logs (1 to 3); Q is extrapolated"
    assert report["warnings"][1].startswith("occlusion of object ")


@pytest.fixture(scope="module")
def sure(tmp_path_factory):
    """A policy that was learned with pessimism, and so holds how sure its Q is."""
    folder, actions = tmp_path_factory.mktemp("act") / "sure", {1: ["A", "B"], 2: ["A", "C"]}
    kept(CensoredQLearner(2, actions, ["x1", "x2"], q_function="linear", stages="separate", reg=0.1), FLAT, folder)
    return folder


def test_how_sure_it_is_stands_beside_each_value(sure, tmp_path):
    report = report_of(sure, state(tmp_path))
    assert list(report["intervals"]) == list(report["chance_best"]) == ["A", "B"]
    lines = run(sure, state(tmp_path)).splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("action"))
    assert lines[at].split() == ["action", "value", "95", "%", "interval", "best"]
    for line in lines[at + 1 : -1]:
        name, value, low, _, high, best = line.split()
        assert value == f"{report['q_values'][name]:+.2f}"
        assert [low, high] == [f"{end:+.2f}" for end in report["intervals"][name]]
        assert best == f"{report['chance_best'][name]:.0%}"


def test_values_in_a_large_unit_are_distinguished(tmp_path):
    small = Logs(FLAT.stages.assign(reward=FLAT.stages["reward"] * 1e-4), FLAT.trajectories)
    kept(flat_learner(), small, tmp_path / "small")
    report, lines = (ask(tmp_path / "small", state(tmp_path)) for ask in (report_of, run))
    rows = dict(line.split()[:2] for line in lines.splitlines() if line.startswith(("A  ", "B  ")))
    assert rows == {name: f"{report['q_values'][name]:+.3g}" for name in ("A", "B")}
    assert "worth as much" not in report["reason"]


def test_a_picture_is_drawn_and_stands_for_nothing_that_is_there(sure, tmp_path):
    plain = run(sure, state(tmp_path))
    for ending, start in ((".png", b"\x89PNG"), (".svg", b"<?xml")):
        target = tmp_path / "new" / f"decision{ending}"
        assert run(sure, state(tmp_path), "--picture", target) == plain
        drawn = target.read_bytes()
        assert drawn.startswith(start)
        run(sure, state(tmp_path), "--picture", target, "--overwrite")
        assert target.read_bytes() == drawn
    assert len(list((tmp_path / "new").iterdir())) == 2


def test_a_table_of_other_things_is_reported_of_first(tables, tmp_path):
    write_pcd(boxes_cloud(), tmp_path / "boxes.pcd")
    lines = run(tables, tmp_path / "boxes.pcd").splitlines()
    assert lines[0].startswith("warning: this is not a table of cups, and nothing was learned about other objects: 0 ")
    assert lines[1].split()[0] in ("WASH", "LIFT", "FINISH")
    assert f"warning: {report_of(tables, tmp_path / 'boxes.pcd')['warnings'][0]}" == lines[0]
    assert "table of cups" not in run(tables, TABLE)


def test_a_decision_tells_what_is_left_out_and_hides(tables, tmp_path):
    write_pcd(draw(Can(-0.40, 0.02), Can(-0.43, -0.08, 0.06, 0.14), Can(0.1, 0.0)).cloud, tmp_path / "cut.pcd")
    hidden = [seen.id for seen in perceive(read_cloud(tmp_path / "cut.pcd")).objects if seen.occlusion > 0.1]
    message = (
        f"left out: 1 that the image border cuts; what is cut by the image border or beside the table hides {hidden[0]}"
    )
    assert f"{message}, which counts as in view" in report_of(tables, tmp_path / "cut.pcd")["warnings"]
    assert "left out" not in run(tables, TABLE)


@pytest.fixture(scope="module")
def coloured(tmp_path_factory):
    """The table with colour: the first object has a patch as brown as a stain."""
    cloud = read_cloud(TABLE)
    view = perceive(cloud)
    colours = np.full(cloud.points_m.shape, (238, 236, 230), dtype=np.uint8)
    colours[view.objects[0].pixels[:400]] = (98, 62, 30)
    path = tmp_path_factory.mktemp("act") / "coloured.pcd"
    write_pcd(replace(cloud, colours=colours), path)
    return path, view


def log_odds_of(policy, cloud, **more):
    return np.asarray(see_table(read_policy(policy), cloud, **more).present.state.log_odds)


def test_colour_moves_the_log_odds_by_what_a_label_says(tables, coloured):
    cloud, view = coloured
    moved = log_odds_of(tables, cloud) - log_odds_of(tables, TABLE)
    right = 0.5 + 0.3 * (1 - view.scene().occlusion) ** 1.5
    sign = np.array([1.0, -1.0, -1.0, -1.0, -1.0])
    np.testing.assert_allclose(moved, sign * np.log(right / (1 - right)), rtol=1e-4)
    plain, report = report_of(tables, TABLE), report_of(tables, cloud)
    chances = 1 / (1 + np.exp(-log_odds_of(tables, cloud).astype(float)))
    each = ", ".join(f"{k}: {chance:.2f}" for k, chance in enumerate(chances))
    sentence = f"Labels by colour (dirty: 0; clean: 1, 2, 3, 4); P(dirty) is {each}."
    assert report["seen"] == sentence == run(tables, cloud).splitlines()[1]
    assert report["p_dirty"] == pytest.approx(chances)
    assert list(plain) == [key for key in report if key not in ("seen", "p_dirty")]
    assert report["q_values"] != plain["q_values"]


def test_labels_of_a_file_stand_before_colour_and_unknown_moves_nothing(tables, coloured, tmp_path):
    labels = state(tmp_path, "labels.csv", "object,label\n0,clean\n1,dirty\n2,unknown\n3,unknown\n4,unknown\n")
    for cloud in (coloured[0], TABLE):
        moved = log_odds_of(tables, cloud, labels=labels) - log_odds_of(tables, TABLE)
        assert np.sign(moved).tolist() == [-1, 1, 0, 0, 0]
        said = run(tables, cloud, "--labels", labels)
        assert f"Labels by {labels} (dirty: 1; clean: 0; unknown: 2, 3, 4); P(dirty) is 0: " in said


def test_a_label_is_worth_what_the_law_says_to_a_policy_that_counts_views(tables, coloured, tmp_path):
    law, (cloud, view), policy = read_law(shipped_law()).law, coloured, tmp_path / "counting"
    logs = TableWorld(law.config(WorldConfig(horizon=3))).simulate([law.scene(view)], UniformPolicy(), 40, 0)
    assert kept(CensoredQLearner.for_table(3, reg=0.1), logs, policy).record["schema"]["counts_views"]
    positive = law.seeing.positive(view.scene().occlusion, 0.0)
    expected = label_evidence(*positive, np.array([True, *[False] * 4]))
    result, plain = (see_table(read_policy(policy), file, law=law).present.state for file in (cloud, TABLE))
    np.testing.assert_allclose(result.log_odds - plain.log_odds, expected, rtol=1e-4)
    np.testing.assert_allclose(result.grip, law.scene(view).grip, rtol=1e-5)
    chances = 1 / (1 + np.exp(-result.log_odds.astype(float)))
    by = f"P(dirty) is {', '.join(f'{k}: {chance:.2f}' for k, chance in enumerate(chances))}."
    for words, is_so in (((), True), (("--law", "shipped"), True), (("--law", "assumed"), False)):
        assert (by in run(policy, cloud, *words)) is is_so


@pytest.mark.slow
def test_a_history_tells_what_was_seen_before_and_what_it_holds_is_not_counted_again(refused, tables, begun, coloured):
    held = log_odds_of(tables, TABLE, past=past_in(begun))
    np.testing.assert_array_equal(log_odds_of(tables, coloured[0], past=past_in(begun)), held)
    assert "are not counted again: the history holds" in run(tables, coloured[0], "--history", begun)
    report, fresh = report_of(tables, TABLE, "--history", begun), report_of(tables, TABLE)
    assert report["stage"] == 1
    assert report["q_values"]["FINISH"] != fresh["q_values"]["FINISH"]
    assert "leave --stage out" in refused("act", tables, TABLE, "--history", begun, "--stage", 2)


def test_a_policy_is_exported_once_and_replaced_only_when_reported(typed, refused, house, tmp_path):
    out = tmp_path / "policy.onnx"
    done = typed("export", house / "policy", "--onnx", out)
    assert (done.status, done.out.split()[0]) == (0, f"{out}:")
    assert [each.name for each in onnxruntime.InferenceSession(out).get_inputs()] == ["covariates", "stage"]
    assert "--overwrite" in refused("export", house / "policy", "--onnx", out)
    assert typed("export", house / "policy", "--onnx", out, "--overwrite").status == 0


@pytest.mark.slow
def test_a_policy_of_tables_is_exported_for_a_number_of_objects(typed, house, tmp_path):
    out = tmp_path / "policy.onnx"
    assert typed("export", house / "table-policy", "--onnx", out, "--objects", 4).status == 0
    shapes = {each.name: each.shape for each in onnxruntime.InferenceSession(out).get_inputs()}
    assert (shapes["hides"], shapes["log_odds"], shapes["steps_to_go"]) == ([4, 4], [4], [])
