"""The experiments, in the order of the report; a new one, with its figure, is a new file and a line here."""

from halfseen.study.experiment import Experiment
from halfseen.study.experiments.attempts import Attempts
from halfseen.study.experiments.censoring import Censoring
from halfseen.study.experiments.clutter import Clutter
from halfseen.study.experiments.grasp import GraspModels
from halfseen.study.experiments.planning import Planning
from halfseen.study.experiments.regret import Regret
from halfseen.study.experiments.reward import Reward

EXPERIMENTS: tuple[Experiment, ...] = (
    Reward(),
    Planning(),
    Censoring(),
    GraspModels(),
    Attempts(),
    Clutter(),
    Regret(),
)
