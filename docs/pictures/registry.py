"""All pictures that README and docs show."""

from pictures.comparison import COMPARISON
from pictures.decision import DECISION
from pictures.examples import EXAMPLES
from pictures.films import FILMS, WATCHED
from pictures.icu_sepsis import ICU_SEPSIS
from pictures.intervals import INTERVALS
from pictures.law import HELD
from pictures.log_figures import PICTURES as OF_LOGS
from pictures.lost_worker import LOST_WORKER
from pictures.medians import MEDIANS
from pictures.memory import MEMORY
from pictures.monitor import MONITOR
from pictures.page_figures import PICTURES as OF_PAGES
from pictures.pick_cell_learners import PICK_CELL_LEARNERS
from pictures.published import PUBLISHED
from pictures.report_values import REPORT_VALUES
from pictures.study_figure import FIGURE1, OPENING
from pictures.tiger_doors import TIGER
from pictures.treatments import TREATMENTS
from pictures.two_planners import TWO_PLANNERS
from pictures.view_figures import PICTURES as OF_VIEWS
from pictures.way_of_the_data import WAY_OF_THE_DATA
from pictures.wire import WIRE
from pictures.wrong_laws import WRONG_LAWS

PICTURES = (
    *(OPENING, FIGURE1, WAY_OF_THE_DATA, *FILMS, WATCHED, HELD, *EXAMPLES),
    *(*OF_LOGS, *OF_PAGES, *OF_VIEWS),
    *(DECISION, TREATMENTS, MEDIANS, INTERVALS, TWO_PLANNERS, MEMORY, PICK_CELL_LEARNERS, REPORT_VALUES, TIGER),
    LOST_WORKER,
    WRONG_LAWS,
    COMPARISON,
    MONITOR,
    WIRE,
    ICU_SEPSIS,
    PUBLISHED,
)
