import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "examples" / "tiger.py"


def test_the_script_prints_the_exact_optimum_and_listens_until_it_is_sure():
    done = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr) == (0, "")

    lines = done.stdout.splitlines()
    assert lines[:3] == [
        "horizon 1: worth -1.0000, first listen",
        "horizon 2: worth -1.9500, first listen",
        "horizon 3: worth 2.3098, first listen",
    ]
    assert [line.rsplit(": ", 1)[1] for line in lines[4:]] == ["listen", "listen", "listen", "open right"]
