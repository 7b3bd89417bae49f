import inspect
import re
import subprocess
import sys
from pathlib import Path

from tiger import TigerProblem

from halfseen.planners import GenerativeProblem

SCRIPT = Path(__file__).parents[2] / "examples" / "tiger.py"


def test_the_script_searches_more_with_more_time_and_says_what_it_did_not_search():
    done = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr) == (0, "")
    head, *lines = done.stdout.splitlines()

    assert head == "The tiger, three actions: the optimum listens and is worth 2.310."
    found = [
        re.fullmatch(r"[\d.]+ s: +(\d+) simulations, (.+), value (-?[\d.]+)( \(not searched\))?", x) for x in lines
    ]
    assert len(lines) == 4
    numbers = [int(match[1]) for match in found]
    assert numbers == sorted(numbers)
    assert [match[4] is None for match in found] == [number > 0 for number in numbers]
    assert found[-1][2] == "listen"
    assert abs(float(found[-1][3]) - 2.310) < 1.0


def test_a_problem_takes_some_thirty_lines():
    assert isinstance(TigerProblem(), GenerativeProblem)
    code = [line for line in inspect.getsource(TigerProblem).splitlines() if line.strip() and '"""' not in line]
    assert len(code) <= 30
