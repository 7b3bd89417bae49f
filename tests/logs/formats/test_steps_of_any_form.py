"""Episodes of any lengths and endings: each form that has what was observed last gives the log that they are."""

import numpy as np
import test_step_arrays as in_hdf5
import test_step_tables as in_rows
from foreign import assert_is, episodes, expected, last_of, write_lerobot
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from halfseen.logs.formats import StepRules, read_lerobot, read_step_arrays, read_steps

FINISHED, CUT = ("finished", None), ("cut", "truncated")
ENDED = st.lists(st.tuples(st.integers(1, 5), st.booleans()), min_size=1, max_size=5)


def times(found, step_s):
    return [step_s * np.arange(1.0, len(each["actions"]) + 1) for each in found]


@given(ENDED, st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from(["parquet", "csv", "feather"]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
def test_each_form_is_the_same_log(tmp_path_factory, ended, seed, is_text, kind):
    folder = tmp_path_factory.mktemp("steps")
    found = episodes(seed, [length for length, _ in ended], is_text=is_text)
    terminal = [is_terminal for _, is_terminal in ended]
    endings = [FINISHED if is_terminal else CUT for is_terminal in terminal]
    rules = StepRules(step_s=0.25)

    file = in_rows.write(folder / "rows", in_rows.rows_of(found, terminal), kind=kind)
    names = [f"e{number}" for number in range(len(found))]
    assert_is(read_steps(file, rules), expected(found, endings, times(found, 0.25), in_rows.SEEN, names=names))

    ends = [[number for number, is_over in enumerate(terminal) if is_over is wanted] for wanted in (True, False)]
    file = in_hdf5.write(folder / "steps.hdf5", in_hdf5.arrays(found, *ends))
    assert_is(read_step_arrays(file, rules), expected(found, endings, times(found, 0.25), in_hdf5.SEEN))

    write_lerobot(folder, found, fps=29.97, extra={"next.done": last_of(found, terminal)})
    logs = read_lerobot(folder)
    columns = ["observation.state_0", "observation.state_1"]
    assert_is(logs, expected(found, endings, times(found, 1 / 29.97), columns, has_last=False), rtol=1e-12)
