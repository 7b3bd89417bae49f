import re
from pathlib import Path

README = Path(__file__).parent.parent / "README.md"


def printed_by_examples(capsys):
    for example in re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(compile(example, str(README), "exec"), {})
        yield capsys.readouterr().out.splitlines()


def test_the_python_examples_run_and_show_what_is_said_of_them(capsys):
    policies, planned, times = printed_by_examples(capsys)
    logged, learned = (float(line.split()[-1]) for line in policies[-2:])
    assert learned > logged

    heuristic, planner = (float(line.split()[2]) for line in planned[:2])
    assert planner < heuristic
    assert planned[-1].startswith("LIFT 1: best with probability")

    late_s = {line.split()[0]: float(re.findall(r"[\d.]+", line)[1]) for line in times[-4:]}
    error_s = {censoring: abs(late - 6.7) for censoring, late in late_s.items()}
    assert error_s["cox"] < error_s["kaplan-meier"] < error_s["none"]
    assert error_s["kernel"] < error_s["kaplan-meier"]
