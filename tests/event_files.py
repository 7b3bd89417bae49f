"""Tables of events and of stages as other programs export them, and the mappings by which they are read."""

import io
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

GERMAN = """\
Zeit;Lauf;Ereignis;Text;Wert
2025-10-26T02:59:50+02:00;7;Gewicht;;0,5
2025-10-26T02:59:58,5+02:00;7;Griff;Säule;
2025-10-26T02:00:01+01:00;7;Ablage;;1,25
2025-10-26T02:00:02+01:00;7;Gewicht;;0,75
2025-10-26T02:00:03+01:00;7;Griff;Kiste;
2025-10-26T02:00:05+01:00;7;Ablage;;-2,5
2025-10-26T02:00:06+01:00;7;Ende;fertig;
2025-10-26T02:10:00+01:00;8;Gewicht;;1,0
2025-10-26T02:10:02+01:00;8;Griff;Kiste;
2025-10-26T02:10:04+01:00;8;Ende;Not-Halt;
2025-10-26T02:20:00+01:00;9;Gewicht;;1,5
2025-10-26T02:20:03+01:00;9;Griff;Säule;
2025-10-26T02:20:07+01:00;9;Herzschlag;;
"""
HISTORIAN = """
topic = "Ereignis"
clock = {field = "Zeit"}
trajectory = {field = "Lauf"}
action = {topic = "Griff", field = "Text", values = {"Säule" = "column"}}
reward = {topic = "Ablage", field = "Wert"}
ending = {topic = "Ende", field = "Text", finished = ["fertig"], values = {"Not-Halt" = "emergency stop"}}
covariates.weight = {topic = "Gewicht", field = "Wert"}
"""
WIDE = """\
run,tool,seconds left,ms,worth,stop
a,suction,9.5,1500,2.5,
a,soft,8,4000,-1,
b,soft,9.5,2000,1,
b,suction,6.25,2500,,operator
"""
STAGES = """
clock = {field = "ms", unit = "ms", since = "trajectory"}
trajectory = {field = "run"}
action = {field = "tool"}
reward = {field = "worth"}
ending = {field = "stop", finished = [""]}
covariates.left = {field = "seconds left"}
"""
PLC = """\
t;tag;v
100.5;MODE;3
101;BEGIN;
101.5;LOOK;0.25
102;PICK;soft
104.5;OK;
105;END;done
200;BEGIN;
200.25;LOOK;0.5
201;PICK;hard
203;NOK;
203.5;LOOK;0.75
204;PICK;soft
205;HEARTBEAT;
"""
BEGUN = """
topic = "tag"
clock = {field = "t", unit = "s"}
trajectory = {topic = "BEGIN"}
action = {topic = "PICK", field = "v"}
reward = {topic = ["OK", "NOK"], values = {OK = 1, NOK = -0.5}}
ending = {topic = "END", field = "v", finished = ["done"]}
covariates.clutter = {topic = "LOOK", field = "v"}
"""
PATIENTS = """\
"id","age","dose.1","sofa.1","day.1","dose.2","sofa.2","day.2","y","reason"
"p1",50,"low",3,7,"high",5,14,1.5,NA
"p2",61,"high",4,7,NA,NA,NA,2,NA
"p3",47,"low",4,7,"low",6,10,NA,"moved"
"p4",47,"low",NA,3,NA,NA,NA,NA,"withdrew"
"""
"""A trial as R's `reshape` and `write.csv` leave it; p2 responded after the first stage, p3 and p4 were lost."""
TRIAL = """
wide = "{name}.{stage}"
table.missing = ["NA"]
clock = {field = "day", unit = "d", since = "trajectory"}
trajectory = {field = "id"}
action = {field = "dose"}
reward = {field = "y"}
ending = {field = "reason", finished = [""]}
covariates.age = {field = "age"}
covariates.sofa = {field = "sofa"}
"""


def write_events(folder: Path) -> pa.Table:
    """Write a historian's events as CSV of Windows and as Parquet, and their mapping; the table of the latter."""
    (folder / "events.csv").write_bytes(GERMAN.encode("cp1252"))
    (folder / "events.toml").write_text(HISTORIAN, encoding="utf-8")
    frame = pd.read_csv(io.StringIO(GERMAN), sep=";", decimal=",")
    times = pd.to_datetime(frame["Zeit"].str.replace(",", "."), format="ISO8601", utc=True)
    frame = frame.assign(Zeit=times.dt.tz_convert("Europe/Berlin"), Text=frame["Text"].astype("category"))
    table = pa.Table.from_pandas(frame, preserve_index=False)
    pq.write_table(table, folder / "events.parquet")
    return table


AMERICAN = """
clock = {field = "time", begin = "time"FORMAT, zone = "America/Chicago"}
trajectory = {field = "run"}
action = {field = "tool"}
reward = {field = "worth"}
ending = {field = "over", finished = ["yes"]}
"""


def rows_of(frame, *columns):
    """Rows as tuples, null as None."""
    return [tuple(None if pd.isna(cell) else cell for cell in row) for row in frame[list(columns)].to_numpy().tolist()]


def stages(logs, *covariates):
    return rows_of(logs.stages, "trajectory", "stage", "elapsed_s", "action", "reward", *covariates)


def ends(logs):
    return rows_of(logs.trajectories, "trajectory", "end_s", "ending", "cause")


GERMAN_STAGES = [
    # 02:59:50 in summer is 10 s before 02:00:00 in winter: that night has the hour from 2 to 3 twice.
    (7, 1, 11.0, "column", 1.25, 0.5),
    (7, 2, 15.0, "Kiste", -2.5, 0.75),
    (8, 1, None, "Kiste", None, 1.0),
    (9, 1, None, "column", None, 1.5),
]
GERMAN_ENDS = [(7, 16.0, "finished", None), (8, 4.0, "cut", "emergency stop"), (9, 7.0, "cut", "log ended")]
