"""Drafts of mappings: taken literally, they do not make a wrong log without a word."""

import pytest

from refusals import refused

STOPS = """run,tool,t,score,status
1,a,1,0.5,
1,b,2,1.5,{one}
2,a,3,2.5,{other}
"""


def test_an_empty_cell_is_no_finish_where_each_trajectory_has_an_ending(draft):
    message = '# guess: endings that are not cuts, "" for an empty cell'
    draft(STOPS.format(one="SUCCEEDED", other="PREEMPTED"), f'finished = ["SUCCEEDED"]  {message}')
    draft(STOPS.format(one="grün", other="rot"), f"finished = []  {message}")
    draft(STOPS.format(one="rot", other=""), f'finished = [""]  {message}')


TIMES = "run,tool,{name},score,stop\n" + "".join(
    f"{run},{'ab'[stage]},{{times[{2 * run + stage}]}},1,{'operator' * stage * run}\n"
    for run in (0, 1)
    for stage in (0, 1)
)


@pytest.mark.parametrize(
    ("name", "times", "since"),
    [
        ("cycle_ms", ["8000", "3000", "4000", "5000"], "stage"),
        ("time", ["8,5", "8,5", "4", "5"], "stage"),
        ("time", ["0:00:10", "0:00:04", "0:00:05", "0:00:09"], "stage"),
        ("time", ["9,5", "10,25", "4", "5"], "trajectory"),
        ("time", ["0:00:04", "0:00:10", "26:00:05", "26:00:09"], "trajectory"),
        ("time", ["10", "4", "5", "2"], "trajectory"),
    ],
)
def test_times_that_fall_within_trajectories_count_from_each_stage(draft, name, times, since):
    text = TIMES.replace(",", ";").format(name=name, times=times)
    other = {"stage": "trajectory", "trajectory": "stage"}[since]
    draft(text, f'since = "{since}"  # guess: numbers count from there, or from the "{other}"')


def test_numbers_that_are_dates_do_not_count_from_a_beginning(draft):
    times = [f"17724312{second}000000000" for second in ["08", "11", "20", "35"]]
    made = draft(TIMES.format(name="%time", times=times), '# begin = "COLUMN"  # no column looks like it')
    assert "since" not in made


TRIAL = """USUBJID,VISITDY,EXTRT,CHG,DSDECOD
AB-1,8,low,0.5,
AB-1,15,high,1.5,COMPLETED
AB-2,7,low,,LOST TO FOLLOW-UP
"""
STUDY = """subject,ts,treatment,outcome,censored
1,8,low,0.5,FALSE
1,15,high,1.5,FALSE
2,7,low,,TRUE
"""


def test_a_trial_is_recognised_and_a_fraction_ends_nothing(draft):
    draft(
        TRIAL,
        "field = \"USUBJID\"  # guess: such as 'AB-1' and 'AB-2'",
        "field = \"VISITDY\"  # guess: such as '8' and '15'",
        "field = \"EXTRT\"  # guess: such as 'low' and 'high'",
        "field = \"DSDECOD\"  # guess: such as 'COMPLETED' and 'LOST TO FOLLOW-UP'",
    )
    made = draft(
        STUDY,
        "field = \"subject\"  # guess: such as '1' and '2'",
        "field = \"ts\"  # guess: such as '8' and '15'",
        "field = \"treatment\"  # guess: such as 'low' and 'high'",
        "[reward]",
        "field = \"outcome\"  # guess: such as '0.5' and '1.5'",
    )
    assert "\n[ending]" not in made
    draft(STUDY.replace("outcome", "result"), "# [ending]")


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("VISITDY", "d"),
        ("Day", "d"),
        ("Elapsed Hours", "h"),
        ("Dauer Minuten", "min"),
        ("TimeMs", "ms"),
        ("time_s", "s"),
    ],
)
def test_the_unit_is_taken_from_the_name_however_it_is_written(draft, name, unit):
    draft(TRIAL.replace("VISITDY", name), f'unit = "{unit}"  # guess: s, ms, us, ns, min, h or d')


def test_what_no_event_looks_like_is_reported_with_its_event(draft):
    made = draft(
        "ts,event,value\n"
        + "".join(f"{second},{tag},{second}\n" for second, tag in enumerate(["START", "GRIP", "PV"])),
        '# topic = "EVENT"  # no event looks like it; if one carries it, name both',
        "field = \"value\"  # guess: such as '0' and '1'",
        "# field = \"COLUMN\"  # no column looks like it; there are 'ts', 'event', 'value'",
    )
    assert made.count('# topic = "EVENT"') == 2  # of rewards and endings
    made = draft(TRIAL.replace("USUBJID", "NAME"), "# [trajectory]")
    assert "'DSDECOD'; without it, each file is one trajectory" in made


WAVES = "id,x1,treat1,day1,score1,x2,treat2,day2,score2\n1,0.5,low,3,1.5,.,,.,.\n2,0.7,high,4,0.5,0.25,low,9,2.5\n"


def test_a_point_alone_is_what_stata_and_sas_write_for_nothing(draft):
    made = draft(
        WAVES, 'missing = ["."]  # guess: texts of empty cells', 'unit = "d"  # guess: s, ms, us, ns, min, h or d'
    )
    assert (
        "field = \"score\"  # guess: such as '1.5' and '0.5'" in made[made.index("[reward]") : made.index("[ending]")]
    )


def test_a_time_that_lasts_needs_no_unit(read_table):
    mapping = """
        clock = {field = "took", unit = "s", since = "trajectory"}
        trajectory = {field = "run"}
        action = {field = "tool"}
        reward = {field = "worth"}
        ending = {field = "stop", finished = ["ok"]}
    """
    text = "run,tool,took,worth,stop\n1,a,0:00:08,1,\n1,b,26:00:00,2,ok\n"
    with refused(r"line 2, column 'took': '0:00:08' .* it counts by itself; leave clock\.unit out"):
        read_table(text, mapping)
    assert read_table(text, mapping.replace('unit = "s", ', "")).stages["elapsed_s"].tolist() == [8.0, 93600.0]


def test_minutes_and_seconds_are_no_times_of_day(draft):
    rows = "".join(f"{run},{tool},{took},1,\n" for run, tool, took in (("a", "x", "1:30"), ("a", "y", "0:45")))
    text = f"run,tool,took,worth,stop\n{rows}"
    draft(text, 'unit = "min"  # guess: of minutes and seconds, as in 1:30; "h" of hours and minutes')


def test_durations_of_a_workbook_are_days_and_a_clock_on_the_wall_counts_from_nothing(draft):
    days = [repr(seconds / 86400.0) for seconds in (8, 19, 75, 90061)]
    draft(TIMES.format(name="duration", times=days), 'unit = "d"  # guess: s, ms, us, ns, min, h or d')
    draft(
        TIMES.format(name="duration", times=[0.5, 1.25, 2.5, 3.125]), 'unit = "s"  # guess: s, ms, us, ns, min, h or d'
    )
    made = draft(
        TIMES.format(name="tod", times=["06:00:02", "06:00:08", "06:01:00", "06:01:05"]), 'format = "%H:%M:%S"  # guess'
    )
    assert "since" not in made


def test_whole_numbers_may_name_actions(draft):
    steps = "ep,t,action,reward,done\n1,1.5,0,0.5,false\n1,2.5,3,0.25,true\n"
    draft(steps, "field = \"ep\"  # guess: such as '1'", "field = \"action\"  # guess: such as '0' and '3'")
    draft(steps.replace(",3,", ",0.5,"), "# [action]")


def test_a_heading_is_found_below_as_many_other_lines_as_there_are_rows(draft):
    assert "heading = 3  # guess: the line that names the columns" in draft("of X\nof Y\nrun,tool,ms\na,x,1500\n")
    # As InfluxDB exports it, with the times between which was asked.
    annotated = "#group,false,false,true,true\n#default,,,,\n,_start,_time,run,tool\n"
    annotated += "".join(f",2025-01-01T00:00:00Z,2025-01-01T00:00:0{k}Z,1,{tool}\n" for k, tool in enumerate("ab"))
    made = draft(annotated)
    assert "heading = 3  # guess: the line that names the columns" in made
    assert '[clock]\nfield = "_time"' in made


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("event", 'finished = {field = "event"}'),
        ("censored", '# field = "censored"'),
        ("success", '# field = "success"'),
    ],
)
def test_indicators_of_survival_are_no_covariates(draft, name, line):
    made = draft(f"run,tool,ms,worth,{name}\na,x,1500,1,0\na,y,2500,2,1\n")
    assert line in made
    assert f"\n[covariates.{name}]" not in made


def test_ends_of_stages_are_empty_where_they_were_cut_and_empty_columns_are_no_covariates(draft):
    rows = "P1,2026-03-02 06:00:00,,,3.5,place,\nP2,2026-03-02 06:01:00,2026-03-02 06:01:05,,,lift,1.0\n"
    made = draft(f"pallet,step_start,step_end,vacuum,gap,action,reward\n{rows}")
    assert '\nfield = "step_end"' in made
    assert '\nbegin = "step_start"' in made
    assert '[trajectory]\nfield = "pallet"' in made
    assert "[covariates.gap]" in made
    assert "[covariates.vacuum]" not in made


def test_times_beside_a_count_of_stages_are_no_covariates(draft):
    heading = "Part No,Gap 1,Tool 1,Time A [s],Gap 2,Tool 2,Time B [s],Result"
    made = draft(f"{heading}\nA,0.1,x,2.5,0.2,y,4.5,ok\nB,0.3,y,3.5,,,,ok\n")
    assert "[clock]\nfield = \"stage\"  # guess: such as '1' and '2'\nunit = \"s\"" in made
    assert '\n# [covariates."Time A [s]"]' in made
    assert "\n[covariates.Gap]" in made


def test_times_by_stage_with_a_unit_are_the_clock(draft):
    made = draft("Part No,Tool 1,Time 1 [s],Tool 2,Time 2 [s],Result\nA,x,2.5,y,4.5,ok\nB,y,3.5,,,ok\n")
    assert "[clock]\nfield = \"Time [s]\"  # guess: such as '2.5' and '4.5'\nunit = \"s\"" in made


def test_the_name_of_the_trajectory_in_each_row_is_what_no_event_carries(draft):
    rows = "06:00:00;1;Start;;\n06:00:01;1;Spalt;;0,5\n06:00:02;1;Griff;Sauger;\n06:00:03;1;Ende;fertig;\n"
    made = draft(f"Uhrzeit;Nr;Ereignis;Text;Wert\n{rows}{rows.replace(';1;', ';2;').replace('0,5', '0,25')}")
    assert '[trajectory]\ntopic = ["Start"]  # guess: these events carry it\nfield = "Nr"' in made
    assert made.count('field = "Nr"') == 1
