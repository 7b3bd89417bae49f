"""All pictures that README and docs show."""

from pictures.examples import EXAMPLES
from pictures.films import CLOSED_LOOP, WATCHED
from pictures.law import HELD
from pictures.learned_figures import PICTURES as OF_LEARNERS
from pictures.log_figures import PICTURES as OF_LOGS
from pictures.page_figures import PICTURES as OF_PAGES
from pictures.study_figure import FIGURE1
from pictures.view_figures import PICTURES as OF_VIEWS
from pictures.way_of_the_data import WAY_OF_THE_DATA

PICTURES = (
    FIGURE1,
    WAY_OF_THE_DATA,
    CLOSED_LOOP,
    WATCHED,
    HELD,
    *EXAMPLES,
    *OF_LOGS,
    *OF_PAGES,
    *OF_VIEWS,
    *OF_LEARNERS,
)
