"""Sound logs raise no data-quality warning; each way of being legal and probably not meant raises its own."""

import re
import tomllib

import numpy as np
import pandas as pd
import pytest

from halfseen.logs import Logs
from halfseen.logs.data_quality import data_warnings
from halfseen.suggestions import alike

NAMES = ("stages", "trajectories", "objects")


def sound_tables(num_trajectories=120, num_stages=4, seed=0):
    """Trajectories of an exploring policy, a third of them cut at any time."""
    rng = np.random.default_rng(seed)
    stages, trajectories, objects = [], [], []
    for trajectory in range(num_trajectories):
        clock_s = np.cumsum(rng.exponential(3.0, num_stages))
        cut_s = rng.exponential(25.0)
        is_cut = cut_s < clock_s[-1]
        cause = rng.choice(["operator", "battery"]) if is_cut else None
        end_s = min(cut_s, clock_s[-1])
        trajectories.append(
            {"trajectory": trajectory, "end_s": end_s, "ending": "cut" if is_cut else "finished", "cause": cause}
        )
        for stage in range(1, int((clock_s <= end_s).sum()) + 1 + int(is_cut)):
            is_completed = clock_s[stage - 1] <= end_s
            at = {"trajectory": trajectory, "stage": stage}
            seen = {"distance": rng.lognormal(), "offset": rng.normal(), "is_wet": rng.random() < 0.5}
            done = {"elapsed_s": clock_s[stage - 1], "reward": rng.normal()} if is_completed else {}
            stages.append(at | seen | {"action": rng.choice(["PICK", "LOOK"]), "probability": 0.5} | done)
            objects.append(at | {"object": 0, "occlusion": rng.random(), "lifts": 0})
    return {name: pd.DataFrame(rows) for name, rows in zip(NAMES, (stages, trajectories, objects), strict=True)}


def found(tables):
    return {warning.kind: warning.sentence for warning in data_warnings(Logs(**tables))}


@pytest.fixture
def tables():
    return sound_tables()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_sound_logs_raise_none(seed):
    assert found(sound_tables(seed=seed)) == {}
    assert found(sound_tables(num_trajectories=12, seed=seed)) == {}


@pytest.mark.parametrize("cut_kind", ["independent", "occlusion", "attempt"])
@pytest.mark.slow
def test_simulated_logs_raise_none(cut_kind):
    from halfseen.planners.heuristics import GreedyPolicy
    from halfseen.world import ExploringPolicy, Scene, TableWorld, WorldConfig

    scene = Scene(np.array([[0.0, 0.4], [0.0, 0.0]]))
    policy = ExploringPolicy(GreedyPolicy(WorldConfig(), True, True), 0.5)
    logs = TableWorld().simulate([scene], policy, 300, 1, 0.33, cut_kind)
    assert data_warnings(logs) == ()


def test_where_every_trajectory_was_cut_it_is_the_first_that_is_said(tables):
    was_cut = tables["trajectories"].loc[tables["trajectories"]["ending"] == "cut", "trajectory"]
    result = found({name: table[table["trajectory"].isin(was_cut)] for name, table in tables.items()})
    assert next(iter(result)) == "all-cut"
    assert result["all-cut"].startswith(f"all {len(was_cut)} trajectories were cut: none was observed to its own end")


def caused(tables, cause, rows=slice(None), end_s=None):
    is_cut = np.flatnonzero(tables["trajectories"]["ending"] == "cut")
    tables["trajectories"].loc[is_cut, "cause"] = "operator"
    tables["trajectories"].loc[is_cut[rows], "cause"] = cause
    if end_s is not None:
        tables["trajectories"].loc[is_cut, "end_s"] = np.linspace(end_s, end_s * 1.001, len(is_cut))


def in_milliseconds(tables, num_first=10, factor=1000):
    for name, column in (("stages", "elapsed_s"), ("trajectories", "end_s")):
        tables[name].loc[tables[name]["trajectory"] < num_first, column] *= factor


def stages(column, value, of=lambda stages: slice(None)):
    """Put a value, or what is made of the values that are there, into some stages."""

    def change(tables):
        rows = tables["stages"]
        rows[column] = rows[column].astype(object) if not callable(value) else rows[column]
        at = of(rows)
        rows.loc[at, column] = value(rows.loc[at, column]) if callable(value) else value
        tables["stages"] = rows.infer_objects()

    return change


def in_text_order(tables):
    for name in NAMES:
        tables[name]["trajectory"] = [f"run-{number}" for number in tables[name]["trajectory"]]


def reward_as_distance(tables):
    rows = tables["stages"]
    rows["reward"] = rows["distance"].where(rows["elapsed_s"].notna())


def an_hour_early(tables):
    for name, column in (("stages", "elapsed_s"), ("trajectories", "end_s")):
        tables[name].loc[tables[name]["trajectory"] >= 60, column] += 3600.0


def of_a_slow_clock(tables):
    for name, column in (("stages", "elapsed_s"), ("trajectories", "end_s")):
        tables[name].loc[tables[name]["trajectory"] % 4 == 3, column] *= 20.0
    tables["stages"]["robot"] = "r" + (tables["stages"]["trajectory"] % 4).astype(str)


def late(rows):
    return rows["trajectory"] >= 60


def without_probability(tables):
    tables["stages"] = tables["stages"].drop(columns="probability")


@pytest.mark.parametrize(
    ("change", "kind", "sentence"),
    [
        *(
            (lambda tables, name=name: caused(tables, name, slice(3)), "end-among-causes",
             f"^3 trajectories are cut by {name!r}: if that is how the task ends")
            for name in ("done", "Success", " finished ")
        ),
        (without_probability, "no-probability",
         "^no action has a probability: learning does not need it, but evaluation does"),
        (lambda tables: caused(tables, "time-out", end_s=tables["trajectories"]["end_s"].max() + 1), "horizon-as-cut",
         "{cuts} of {cuts} cuts by time-out fall at"),
        (in_milliseconds, "mixed-clock-units", r"in (10|9) .*are some clocks in milliseconds\?"),
        (lambda tables: in_milliseconds(tables, 1), "mixed-clock-units",
         r"^stages of trajectory \d+ last .* about 1,000 times as long as those of all others .* in milliseconds\?$"),
        (lambda tables: in_milliseconds(tables, 10**6, 1e-6), "short-clock",
         r"^half of the stages last \S+e-06 s or less: are clocks in days, hours or thousands of seconds\?$"),
        (an_hour_early, "mixed-clock-units",
         r"with none in between: do some clocks start 3,60\d s before the trajectory, as after a shift or in another "),
        (of_a_slow_clock, "clock-of-robot",
         r"^stages of robot 'r3' last \S+ s, and those of all others \S+ s: is its clock right\?$"),
        (in_text_order, "text-order", "where 'run-109' comes before 'run-11', and that order"),
        (reward_as_distance, "reward-as-covariate", "^all {completed} rewards equal distance: was the wrong column"),
        (lambda tables: tables["stages"].insert(0, "tool", tables["stages"]["action"]), "action-as-covariate",
         "^covariate tool is the action of its own stage in all {stages} stages, which nobody knew before: leave it"),
        (stages("offset", -999.0, lambda rows: rows["trajectory"] == 7), "stand-in",
         r"^covariate offset is -999 in \d of {stages} rows, and .* in all others: if that means missing, leave"),
        (stages("distance", 1e6, lambda rows: 5), "stand-in", "^covariate distance is 1000000 in 1 of {stages} rows"),
        (stages("reward", 1e5, lambda rows: 0), "stand-in",
         "^reward is 100000 in 1 of {completed} rows, and .* in all others: it decides what is learned; if it "),
        (lambda tables: tables["stages"].insert(
            0, "view", np.where(tables["stages"]["elapsed_s"].isna(), "lost", tables["stages"]["stage"].astype(str))),
         "never-completed", "^where view is lost, every stage was cut: what follows is unknown"),
        (lambda tables: tables["stages"].insert(0, "is_lost", 1 * tables["stages"]["elapsed_s"].isna()),
         "never-completed", "^where is_lost is 1, every stage was cut"),
        (stages("distance", 0.75, late), "stuck-sensor",
         "^covariate distance is 0.75 in 60 successive trajectories, from 60 to 119, and differs from each other one"),
        *(
            (stages(name, lambda values: values * 1e6, late), "mixed-covariate-units", f"^covariate {name} is around")
            for name in ("distance", "offset")
        ),
        (stages("action", "WASH", lambda rows: 0), "rare-action",
         r"^action WASH \(1\) was taken in less than 1 % of {completed} stages: too few to learn from$"),
        (stages("action", "WASH", lambda rows: rows["elapsed_s"].isna()), "rare-action",
         "^action WASH was begun and never completed: nothing can be learned from that$"),
        (stages("reward", lambda values: values * 0 + 1), "equal-rewards",
         "^all {completed} rewards are 1: no action is better than another$"),
        (stages("reward", 0.0, lambda rows: (rows["stage"] == 1) & rows["elapsed_s"].notna()), "later-rewards",
         r"^the reward is 0 in all \d+ first stages, and in no other: if each came with the observation after its"),
        *(
            (stages(name, value),
             "constant-covariate", f"^covariate {name} is {value!r} in all {{stages}} rows")
            for name, value in (("distance", 0.0), ("offset", 7), ("is_wet", True))
        ),
    ],
)  # fmt: skip
def test_what_was_probably_not_meant_is_asked_about_and_nothing_else(tables, change, kind, sentence):
    change(tables)
    counts = {
        "cuts": (tables["trajectories"]["ending"] == "cut").sum(),
        "completed": tables["stages"]["elapsed_s"].notna().sum(),
        "stages": len(tables["stages"]),
    }
    result = found(tables)
    assert set(result) == {kind}
    assert re.search(sentence.format(**counts), result[kind])


def test_a_success_that_pays_far_more_than_a_step_is_no_far_value(tables):
    rows = tables["stages"]
    steps = np.where(rows["trajectory"] % 40 == 0, 1e6, -0.1 - 0.001 * rows["stage"])
    tables["stages"] = rows.assign(reward=np.where(rows["elapsed_s"].isna(), np.nan, steps))
    assert "stand-in" not in found(tables)


def test_a_value_that_stays_is_no_stuck_sensor_where_it_may(tables):
    rows = tables["stages"]
    rows["setting"] = rows["trajectory"] // 40 * 0.5  # three settings, each kept for 40 trajectories
    rows["start"] = rows["distance"].where((rows["stage"] > 1) | (rows["trajectory"] < 60), 0.25)  # a new default
    rows["few"] = rows["distance"].where(rows["trajectory"] < 100, 0.25)
    assert found(tables) == {}


def test_cuts_in_one_stage(tables):
    cut = tables["trajectories"].loc[tables["trajectories"]["ending"] == "cut", "trajectory"]
    stages = tables["stages"]
    stages = stages[~stages["trajectory"].isin(cut) | (stages["stage"] == 1)].copy()
    stages.loc[stages["trajectory"].isin(cut), ["elapsed_s", "reward"]] = np.nan
    message = f"all {len(cut)} cuts fall in stage 1: does the task itself end trajectories there?"
    assert found({"stages": stages, "trajectories": tables["trajectories"]}) == {"cuts-in-one-stage": message}


def test_object_covariates_of_mixed_units(tables):
    tables["objects"]["occlusion"] += 0.1
    tables["objects"].loc[tables["objects"]["trajectory"] < 20, "occlusion"] *= 1e3
    assert "object covariate occlusion is around" in found(tables)["mixed-covariate-units"]


def test_names_that_differ_in_spelling(tables):
    causes = tables["trajectories"]["cause"]
    tables["trajectories"]["cause"] = causes.where(causes.index % 2 == 0, causes.str.upper())
    tables["stages"].loc[::3, "action"] = tables["stages"]["action"].str.title() + " "
    spelling = [s.sentence for s in data_warnings(Logs(**tables)) if s.kind == "spelling"]
    remedy = "differ only in their spelling: count them as one (in a mapping: values = {{{}}})"
    assert spelling[0] == "causes 'BATTERY', 'battery' " + remedy.format('"battery" = "BATTERY"')
    assert "actions 'PICK', 'Pick ' " + remedy.format('"Pick " = "PICK"') in spelling


NFC, NFD = "caf\u00e9", "cafe\u0301"


E_STOPS = ("E stop", "e_stop", "estop", "E-Stop.", "e - stop", "e\u2010stop")
SAME = [("e-stop", other) for other in E_STOPS]
SAME += [
    ("-x", "\u2212x"),
    ("2.5", " 2.5"),
    ("slot 1 2", "Slot_1_2"),
    ("pick (left)", "pick left"),
    ("\u2190", " \u2190"),
]
SAME += [
    (NFC, NFD),
    (NFC.upper(), NFD),
    ("stra\u00dfe", "STRASSE"),
    ("CUP", "\u0421up"),
    ("\u0412\u0437", "\u0432\u0437"),
]
OTHER = [
    ("+x", "-x", "x", "x+", "x-"),
    ("+x", "\u2212x"),
    ("pick -x", "pick x", "pick +x"),
    ("2.5", "25", "2,5", ".25", "2 5", "2-5"),
    ("x-1", "x1", "x+1"),
    ("slot 1 2", "slot 12"),
    ("cafe", NFC),
    ("cafe", NFD),
    ("\u2190", "\u2192"),
    ("<5", ">5", "5"),
    ("pick!", "pick?"),
    ("-", "_"),
]


@pytest.mark.parametrize(("one", "other"), SAME)
def test_one_name_in_two_spellings(one, other):
    assert alike([one, other, "another"]) == [sorted([one, other])]


@pytest.mark.parametrize("names", OTHER)
def test_signs_decimal_points_and_letters_are_more_than_spelling(names):
    assert alike(names) == []


@pytest.mark.parametrize(
    ("table", "column", "what"),
    [
        ("stages", "action", "actions"),
        ("stages", "place", "values of covariate place"),
        ("objects", "place", "values of object covariate place"),
    ],
)
def test_names_that_look_alike_are_said_by_their_code_points(tables, table, column, what):
    rows = tables[table]
    rows[column] = [(NFC, NFD, "pick")[k % 3] for k in range(len(rows))]
    result = found(tables)["spelling"]
    assert result.startswith(rf"{what} 'cafe\u0301', 'caf\xe9' differ only in their spelling: count them as one (in")
    assert tomllib.loads(result[result.index("values =") : -1])["values"] == {NFC: NFD}


@pytest.mark.parametrize("form", ["{}%", "{},5 kg", "0:{:02}:00", "2025-01-{:02}", "-{} °C"])
def test_texts_of_measured_values(tables, form):
    rows = len(tables["stages"])
    tables["stages"]["c"] = [form.format(10 + k % 12) for k in range(rows)]
    assert (
        f"covariate c is text that looks like numbers, such as '{form.format(10)}'" in found(tables)["number-as-text"]
    )
    # Sizes of a tool, or hours of shifts; numbers of parts; and of bins.
    for name in (form.format, "{:03}".format, lambda k: f"{k}{'AB'[k % 2]}"):
        tables["stages"]["c"] = [name(10 + k % (4 if name == form.format else 12)) for k in range(rows)]
        assert "number-as-text" not in found(tables)


def test_many_whole_numbers_as_text_may_be_sizes(tables):
    for num, is_doubted in ((20, False), (21, True)):
        tables["stages"]["c"] = [str(k % num) for k in range(len(tables["stages"]))]
        result = found(tables)
        assert ("if they are sizes, and no names, write them" in result.get("number-as-text", "")) == is_doubted


def test_numbers_of_one_value_are_one_name(tables):
    rows = len(tables["stages"])
    tables["stages"]["action"] = [("1", "1.5", "0.50", "0.5", "-2")[k % 5] for k in range(rows)]
    assert "actions '0.5', '0.50' differ only in their spelling" in found(tables)["spelling"]
    tables["stages"]["action"] = [("1", "1.5", "2.10", "-1")[k % 4] for k in range(rows)]
    assert "spelling" not in found(tables)


@pytest.mark.parametrize("date", ["2025-03-01", "1-Mar", "Mar-01", "01. Mrz"])
def test_dates_among_names(tables, date):
    tables["stages"].loc[::3, "action"] = date
    assert found(tables)["date-among-names"].startswith(f"actions {date} are dates, and others are not")
    tables["stages"]["action"] = [f"2025-03-0{k % 3 + 1}" for k in range(len(tables["stages"]))]
    assert "date-among-names" not in found(tables)


def test_a_clock_that_runs_on(tables):
    of_each = tables["trajectories"].set_index("trajectory")["end_s"]
    begin_s = of_each.cumsum() - of_each
    for name, column in (("stages", "elapsed_s"), ("trajectories", "end_s")):
        tables[name][column] += begin_s[tables[name]["trajectory"]].to_numpy()
    result = found(tables)["running-clock"]
    assert re.search(
        r"continues across .* first stage of \d+ ends at [\d.]+ s, after the last of \d+ at [\d.]+ s; "
        "count",
        result,
    )


def test_no_exploration(tables):
    tables["stages"]["probability"] = 1.0
    assert set(found(tables)) == {"no-exploration"}
    tables["stages"]["action"] = "PICK"
    assert set(found(tables)) == {"one-action"}


def test_copied_trajectories(tables):
    again = {name: frame[frame["trajectory"].isin([3, 5, 8])] for name, frame in tables.items()}
    again = {name: frame.assign(trajectory=frame["trajectory"] + 1000) for name, frame in again.items()}
    result = found({name: pd.concat([frame, again[name]]) for name, frame in tables.items()})
    assert set(result) == {"duplicated-trajectories"}
    assert re.search(r"\(such as (3 and 1003|5 and 1005)\)", result["duplicated-trajectories"])


def test_trajectories_of_whole_steps_may_agree(tables):
    stages, is_cut = tables["stages"], tables["trajectories"]["ending"] == "cut"
    is_completed = stages["elapsed_s"].notna()
    stages["elapsed_s"] = stages["stage"].where(is_completed).astype(float)
    stages["reward"] = (stages["reward"] > 0).where(is_completed).astype(float)
    tables["trajectories"]["end_s"] = stages.groupby("trajectory")["stage"].max().to_numpy() - 0.5 * is_cut
    assert found(tables) == {}


@pytest.mark.slow
@pytest.mark.parametrize(("code", "lowest"), [(-1.0, 0.0), (-999.0, 0.0), (-9999.0, -50.0), (65535.0, 0.0)])
def test_a_number_that_stands_for_nothing_is_reported(tables, code, lowest):
    seen = tables["stages"]["distance"].clip(upper=20.0) + lowest
    for num in (3, 2):
        tables["stages"]["distance"] = np.where(np.arange(len(seen)) % (len(seen) // num) == 1, code, seen)
        # Twice is too seldom for a code that is near.
        assert set(found(tables)) == ({"stand-in"} if num == 3 or abs(code) > 200.0 else set())
    tables["stages"]["distance"] = np.where(np.arange(len(seen)) % 10 == 0, 0.0, seen + 40.0)
    assert found(tables) == {}


@pytest.mark.parametrize("column", ["reward", "distance"])
def test_a_sign_that_was_lost_is_reported(tables, column):
    stages = tables["stages"]
    small = stages[column].clip(0.0, 3.0).round()
    stages[column] = small.mask((np.arange(len(small)) % 7 == 0) & small.notna(), np.uint8(255))
    assert "is 255 in" in (result := found(tables)["stand-in"])
    assert result.endswith("0 to 3 in all others: was -1 written in a type without a sign?")
    stages[column] = (85.0 * small).mask(small == 2.0, 254.0)
    assert "stand-in" not in found(tables)


def test_true_in_two_spellings_is_reported(tables):
    words = np.resize(["True", "1", "False", "False"], len(tables["stages"]))
    tables["stages"]["is_wet"] = words
    assert found(tables)["truths-mixed"].startswith("covariate is_wet is 'True' and '1' and 'False', each of which")
    tables["stages"]["is_wet"] = np.where(words == "1", "True", words)
    assert found(tables) == {}


@pytest.mark.parametrize("cell", [[0.5, 1.0], [[{"a": True}]], {"a": 1.0}], ids=["list", "nested", "record"])
def test_lists_and_records_in_a_column_are_not_counted(tables, cell):
    tables["stages"]["scan"] = pd.Series([cell] * len(tables["stages"]), dtype=object)
    assert found(tables) == {}
