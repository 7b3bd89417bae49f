"""The picture of the law that ships with the package, drawn from its attempts by the package."""

from pathlib import Path
from tempfile import TemporaryDirectory

from pictures.picture import Picture


def _draw() -> bytes:
    from halfseen.cell.calibration.figures import pictures_of
    from halfseen.cell.calibration.law import ATTEMPTS, read_law, shipped_law
    from halfseen.logs import read_logs

    with TemporaryDirectory() as folder:
        file = Path(folder) / "held.png"
        law, logs = read_law(shipped_law()).law, read_logs(shipped_law() / ATTEMPTS)
        pictures_of(law.grasp.estimate, law.seeing, logs)["held.png"](file)
        return file.read_bytes()


HELD = Picture("held", "src/halfseen/cell/calibration/shipped_law/held.png", _draw, seconds=6.0)
