"""What does not fit is refused in one line with status 2, and nothing is written: a line for each case."""

import socket
import sys

import numpy as np
import pytest
from shell import TABLE

from halfseen.logs import LogRecorder, Logs, read_logs
from small_logs import log_of
from text_arms import HULL, SIX, seven

TINY = [("0 0 0.05", axis, "-170 170") for axis in ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0")]
FILES = {
    "s.json": '{"x1": 0.4, "x2": 1}',
    "far.json": '{"x1": 800, "x2": 1}',
    "other.json": '{"x1": 1, "y": 2}',
    "nan.json": '{"x1": 1, "x2": NaN}',
    "many.json": '{"x1": 1, "x2": "many"}',
    "list.json": "[1, 2]",
    "torn.json": "{",
    "large.json": f'{{"x1": 1{"0" * 400}, "x2": 1}}',
    "two.csv": "x1,x2\n1,2\n3,4\n",
    "none.csv": "",
    "twice.csv": "x1,x2,x1\n1,2,3\n",
    "shifted.csv": "x1,x2\n5,1,2\n",
    "short.csv": "x1,x2\n1\n",
    "third.json": '{"x1": 1, "x2": 2, "stage": 3}',
    "upper.json": '{"x1": 1, "x2": 2, "STAGE": 2}',
    "word.json": '{"x1": 1, "x2": 2, "stage": "two"}',
    "first.json": '{"x1": 1, "x2": 2, "stage": 1}',
    "labels.csv": "object,label\n0,clean\n",
    "broken.pcd": "no cloud at all",
    "broken.npz": "nonsense",
    "broken.toml": "",
    "cloud.xyz": "",
    "there.html": "mine",
    "there.png": "mine",
    "mine/thesis.txt": "mine",
    "folder.png/x": "",
    "six.xml": SIX,
    "tiny.xml": seven(TINY),
    "shapes/hull.obj": HULL,
}
GREEDY = "cell run --policy greedy --tables 2"
ARMS = {
    "--arm none.xml": "none.xml: no such file; give the path of an arm's MJCF file",
    "--arm six.xml --flange tip": "no site or body for a flange is named 'tip'; available: attachment_site",
    "--arm six.xml --joints pan,lift": "six.xml: the arm has 2 joints",
    "--arm six.xml --joints pan,bend": "no joint is named 'bend'; available: pan, lift, elbow",
    "--arm tiny.xml": "'tiny.xml': its hand reaches 0.",
    "--flange tip": "--flange is for an arm from a file; give the file by --arm",
    "--joints pan": "--joints is for an arm from a file; give the file by --arm",
}
REFUSED = [
    ("lern", "lern: unknown command; give one of inspect, learn…; did you mean 'learn'?"),
    ("cell clibrate", "clibrate: unknown command of cell; give one of calibrate, run, film; did you "),
    ("learn --covariats x", "unknown option --covariats; did you mean '--covariates'?"),
    ("evaluate p --simpel", "unknown option --simpel; did you mean '--simple'?"),
    ("--quite learn", "unknown option --quite; did you mean '--quiet'?"),
    ("inspect --zzz", "unknown option --zzz; --help lists the options"),
    ("simulate --out x --policy histry", "; did you mean 'history'?"),
    ("learn x --out p --q-function smoth", "; did you mean 'smooth'?"),
    ("simulate --out x --law shiped", "--law shiped: no such folder; write…; did you mean 'shipped'?"),
    ("learn logs --out new --no-verdict --censoring cox --covariates X1,x2", "; did you mean 'x1'?"),
    ("learn logs --out new --no-verdict --censoring cox --covariates coluor", "; did you mean 'colour'?"),
    ("learn logs --out new --no-verdict --censoring cox --censoring-covariates xx1", "; did you mean 'x1'?"),
    *(
        (f"{verb} --seed {seed}", f"{seed} is not in the range")
        for verb in ("study", "simulate --out x")
        for seed in (-1, 2**32, 2**63)
    ),
    (f"simulate --out x --episodes {10**12}", f"{10**12} is not in the range"),
    (f"simulate --out x --horizon {10**6}", f"{10**6} is not in the range"),
    (f"evaluate x --world --episodes {10**12}", f"{10**12} is not in the range"),
    (f"learn x --out y --horizon {10**6}", f"{10**6} is not in the range"),
    ("serve policy --record policy", "--record is policy, the folder of the policy; give another folder for its logs"),
    ("serve policy --share 0.3", "--share is 0.3, but nothing is compared; give --against RULE"),
    ("serve policy --record logs --most-loss 5", "--most-loss is 5, but nothing is compared"),
    ("serve policy --share nan", "'--share': nan is not a number"),
    ("serve policy --explore nan", "'--explore': nan is not a number"),
    ("act policy far.json", "x1 is 800, outside the logs (…--extrapolate"),
    ("act policy s.json --picture p.jpg", "ends in .png or .svg"),
    ("act policy s.json --picture p", "ends in .png or .svg"),
    ("act table-policy cloud.png --picture cloud.png --overwrite", "it is an input, so it is not replaced"),
    ("act policy s.json --picture there.png", "it already exists"),
    ("act policy s.json --picture folder.png --overwrite", "it is a folder"),
    ("act policy s.json --picture s.json/p.png", "cannot be written"),
    ("act table-policy {table} --law shipped", "every label is new evidence; leave --law out"),
    ("act table-policy {table} --labels labels.csv", "object 1 of 5 has no label"),
    ("act policy s.json --labels labels.csv", "--labels is for tables"),
    ("act policy {table}", "looks at x1, x2, not at clouds"),
    ("act table-policy s.json", "the policy is of tables"),
    ("act policy other.json", "'x2' is missing (given: x1, y)"),
    ("act policy nan.json", "NaN is not a JSON number"),
    ("act policy many.json", "is not numeric"),
    ("act policy list.json", "it holds 0 states"),
    ("act policy torn.json", "it cannot be read"),
    ("act policy large.json", "not a 64-bit whole number"),
    ("act policy two.csv", "it holds 2 states"),
    ("act policy none.csv", "it cannot be read"),
    ("act policy twice.csv", "two columns are called 'x1'"),
    ("act policy shifted.csv", "a row has 3 cells, and the header 2"),
    ("act policy short.csv", "a row has 1 cells, and the header 2"),
    ("act policy none.json", "No such file"),
    ("act policy third.json", "stage is 3"),
    ("act policy upper.json", "it says 'STAGE', which is not read; write it as 'stage'"),
    ("act policy word.json", "stage is 'two'"),
    ("act policy first.json --stage 2", "says 1"),
    ("act policy s.json --stage 3", "stage is 3"),
    ("act policy s.json --history logs", "--history is for tables"),
    ("act table-policy {table} --stage 4", "beyond the policy's horizon of 3 stages"),
    ("act mine {table}", "policy.json: it is missing"),
    (
        "act team-policy {table}",
        "policy: it decides for a team of 2 robots, and needs to know what each robot is doing",
    ),
    ("act table-policy {table} --history team-logs", "logs: the log is of a team of 2, but the policy"),
    (GREEDY + " --arms 2 --arm six.xml --out new", "--arm"),
    (GREEDY + " --arms 3 --out new", "--arms"),
    (GREEDY + " --law none --out new", "cell calibrate"),
    (GREEDY + " --out mine", "--overwrite"),
    (GREEDY + " --out mine --overwrite", "not replaced"),
    ("cell calibrate --out mine", "--overwrite"),
    ("cell calibrate --out mine --overwrite", "not replaced"),
    ("cell calibrate --from logs --out new", "objects: the log has no objects table"),
    ("cell calibrate --from mine --out new", "mine"),
    *((f"{GREEDY} --workers 1 --out new {words}", message) for words, message in ARMS.items()),
    *(
        (f"cell calibrate --attempts 50 --out new {words}", message)
        for words, message in ARMS.items()
        if "tiny" not in words
    ),
    ("cell run --policy none --out new", "halfseen learn"),
    ("cell run --policy planer --arms 2 --out new", "--policy planer: no such folder…did you mean 'planner'?"),
    (
        "cell run --policy policy --out new",
        "it decides for named actions, but one arm clears the table; learn one from",
    ),
    (
        "cell run --policy policy --arms 2 --out new",
        "it decides for named actions, but 2 arms clear the table; learn one from",
    ),
    ("cell run --policy team-policy --out new", "policy: it decides for a team of 2 robots, but one"),
    (
        "cell run --policy team-policy --arms 2 --out new",
        "policy: it was learned for 3 decisions of each robot, but each arm here makes 10; learn it with a horizon",
    ),
    (
        "cell run --policy table-policy --arms 2 --out new",
        "table-policy: it decides for a single robot, but 2 arms clear the table; learn one from logs of 2",
    ),
    ("evaluate policy", "give either --logs"),
    ("evaluate policy --logs logs --world", "give either --logs"),
    ("evaluate policy cloud.ply --logs logs", "clouds are tables to play with --world"),
    ("evaluate policy --logs logs --law shipped", "which is for --world, but --logs is given"),
    ("evaluate policy --world", "takes named actions"),
    ("evaluate nowhere --logs logs", "nowhere"),
    ("evaluate policy --logs nowhere", "nowhere"),
    ("evaluate policy --logs logs --level 2", "--level"),
    ("evaluate policy --logs logs --against nobody", "against is 'nobody'; give logging, logging-rule"),
    ("evaluate policy --logs logs --against nowhere.csv", "nowhere.csv: it cannot be read as a rule"),
    ("evaluate policy --logs logs --against sequence:", "name an action for each stage"),
    ("evaluate policy --logs logs --against table-logs", "table-logs"),
    ("evaluate policy --world --against logging", "--against is for --logs"),
    ("evaluate team-policy --logs table-logs", "the log is of one robot, but the policy decides for a team"),
    ("evaluate table-policy --logs team-logs", "the log is of a team of 2, but the policy decides for one"),
    ("evaluate table-policy --logs table-logs --against team-policy", "policy is for 2 robots"),
    ("evaluate team-policy --logs team-logs --team two.toml", "--team is two.toml, which is for --world"),
    ("evaluate team-policy --world", "policy: it decides for a team of 2 robots, but no --team is given"),
    (
        "evaluate team-policy --world --team three.toml",
        "decides for a team of 2 robots, but three.toml has a team of 3",
    ),
    ("evaluate table-policy --world --team two.toml", "for a single robot, but two.toml has a team of 2"),
    ("export policy --onnx policy.bin", "ends in .onnx"),
    ("learn none --out new", "no such folder"),
    ("learn cut --out new", "all 2 trajectories were cut"),
    ("learn logs --out new --covariates x1,x9", "names 'x9'"),
    ("learn logs --out new --covariates colour", "is 'red' in every stage"),
    ("learn logs --out new --horizon 1", "horizon is 1"),
    ("learn logs --out new --reg -1", "reg is -1"),
    ("learn logs --out new --grasp beta", "--grasp is for logs of tables"),
    ("learn logs --out logs --overwrite", "it holds no policy"),
    ("learn logs --out policy --no-verdict", "it already exists"),
    ("learn team-logs --out new --horizon 2", "--horizon is 2, but a robot of the log has 3 decisions"),
    ("learn team-logs --out new --grasp beta", "--grasp is beta, but the log is of a team"),
    ("learn no-counts --out new", "column '1_decisions_to_go' is missing"),
    ("learn spent --out new", "are at most 0, yet robots decide"),
    ("look cloud.xyz", "not read"),
    ("look broken.npz", "broken.npz"),
    ("look missing.pcd", "no such file"),
    ("look mine", "no file in it ends in .pcd, .ply, .npz; give a folder of clouds"),
    ("look clouds --picture a.png", "--picture a.png: it is for one cloud"),
    ("look clouds --labels a.csv", "--labels a.csv: it is for one cloud"),
    ("look {table} --picture there.png", "it already exists; choose another file, or pass --overwrite"),
    ("look cloud.png --picture cloud.png --overwrite", "is an input, so it is not replaced"),
    ("record none --out new", "No such file"),
    ("record none --listen 0 --out new", "are both given"),
    ("record --listen there.html --out new", "it cannot be listened on"),
    ("record --listen 99999 --out new", "it cannot be listened on"),
    ("report none policy --out new.html", "no such folder"),
    ("report logs none --out new.html", "no such folder"),
    ("report logs logs --out new.html", "it is missing"),
    ("report table-logs policy --out new.html", "covariate 'x1' is missing"),
    ("report logs policy --out new.html --truncate-at 0.5", "truncate_at is 0.5"),
    (f"report logs policy --out new.html --unit {'x' * 30}", "reward_unit is 'xxx"),
    ("report logs policy --out there.html", "it already exists"),
    ("report logs policy --out there.html --overwrite", "it is not a page"),
    ("report team-logs table-policy --out new.html", "the log is of a team of 2, but the policy decides"),
    *(
        (f"report logs --out new.html {option}", f"{option.split()[0]} applies to a policy, but none is given")
        for option in ("--against logging", "--censoring cox", "--replicates 7", "--propensity estimated")
    ),
    ("serve policy --host 0.0.0.0", "--host is 0.0.0.0"),
    ("serve policy --token short", "--token has 5 characters"),
    ("serve policy --explore 1", "--explore"),
    ("serve policy --opcua opc.tcp://127.0.0.1", "--opcua and --mapping go together"),
    ("serve policy --opcua http://h --mapping cell.toml --record new", "give opc.tcp://HOST:PORT"),
    ("serve policy --opcua opc.tcp://me:word@h --mapping cell.toml --record new", "users in --mapping"),
    (
        "serve policy --opcua opc.tcp://127.0.0.1 --mapping cell.toml",
        "decisions over OPC UA need a log; give --record LOGS",
    ),
    ("serve policy --opcua opc.tcp://127.0.0.1 --mapping cell.toml --record new", "cell.toml: it cannot be read"),
    ("serve policy --mapping-template --mapping policy", "policy: it already exists"),
    ("serve nothing --port 0", "no such folder"),
    ("simulate --out new --episodes 0", "--episodes"),
    ("simulate --out new --cut-share 1", "--cut-share"),
    ("simulate --out new --random-share 2", "--random-share"),
    ("simulate --out new --policy lazy", "--policy"),
    ("simulate --out new --horizon 0", "--horizon"),
    ("simulate --out new nowhere.pcd", "nowhere.pcd"),
    ("simulate --out new broken.pcd", "broken.pcd"),
    ("simulate --out logs {table}", "pass --overwrite to replace it"),
    ("simulate --out new --team none.toml", "none.toml: cannot be read"),
    ("simulate --out new --team broken.toml", "broken.toml: no robots"),
    ("study --repetitions 0 --out study", "halfseen: repetitions is 0; "),
    (
        "study --only rewards",
        "--only rewards: unknown experiment; give one of reward, planning…; did you mean 'reward'?",
    ),
    ("study --out there.html/study", "cannot be written"),
    ("study --out study no_such_table.pcd", "no_such_table.pcd"),
    ("study --out study --law no_such_law", "no_such_law"),
    ("watch none.pcd --export out.html", "none.pcd: no such file or folder"),
    ("watch {table} --export film.mp4", "film.mp4: an exported run ends in .html or .gif"),
    ("watch {table} --clouds mine --export out.html", "--clouds is for a source of kind logs"),
    ("watch {table} --history logs --export out.html", "give a --policy"),
    ("watch {table} --policy nowhere --export out.html", "nowhere"),
    ("watch {table} --policy policy --export out.html", "not a policy of tables"),
    ("watch {table} --stages 3-2 --export out.html", "not a span of stages"),
    ("watch {table} --stages 1-2 --export out.html", "--stages is 1-2, but the last stage is 1"),
    ("watch logs --export out.html", "logs hold no clouds"),
    ("watch logs --clouds mine --export out.html", "no column 'cloud'"),
    ("watch logs --clouds mine --trajectory 10000 --export out.html", "has"),
]


@pytest.fixture(scope="module")
def place(house, learned):
    """The house, and beside what is whole there what is not."""
    for name, text in FILES.items():
        (house / name).parent.mkdir(exist_ok=True)
        (house / name).write_text(text)
    (house / "cloud.png").symlink_to(TABLE)
    (house / "clouds").mkdir()
    (house / "clouds" / "cloud.pcd").write_text("no cloud at all")
    log_of({"end_s": [1.0, 2.0]}, trajectory=[0, 1], elapsed_s=np.nan, action=["A", "B"]).write(house / "cut")
    logs = read_logs(house / "team-logs")
    Logs(logs.stages.drop(columns="1_decisions_to_go"), logs.trajectories, logs.objects).write(house / "no-counts")
    none_left = {f"{r}_decisions_to_go": 0 for r in (0, 1)}
    Logs(logs.stages.assign(**none_left), logs.trajectories, logs.objects).write(house / "spent")
    return house


@pytest.fixture
def unchanged(place, monkeypatch):
    """Work in the house, and leave it as it is."""
    monkeypatch.chdir(place)

    def content():
        return {file: file.stat().st_mtime_ns for file in place.rglob("*") if "__pycache__" not in file.parts}

    before = content()
    yield
    assert content() == before


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize(("line", "message"), REFUSED)
def test_what_does_not_fit_is_refused_and_nothing_is_written(refused, line, message):
    err = refused(*line.format(table=TABLE).split())
    assert err.startswith("halfseen: ")
    for part in message.split("…"):
        assert part in err
        err = err[err.index(part) + len(part) :]


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("watch {table} --port", "--port is {port}"),
        ("serve policy --port", "--port {port}: the server cannot listen there"),
    ],
)
def test_a_port_that_is_taken_is_refused(refused, line, message):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert message.format(port=port) in refused(*line.format(table=TABLE).split(), port)


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("export", [[], ["--export", "out.html"]])
def test_a_viewer_that_is_not_there_is_reported(refused, monkeypatch, export):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "[watch]" in refused("watch", TABLE, *export)


def test_a_log_has_one_recorder(refused, tmp_path):
    with LogRecorder(tmp_path / "logs"):
        assert "another recorder" in refused("record", "--listen", 0, "--out", tmp_path / "logs")
