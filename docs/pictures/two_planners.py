"""What the planner of the page on planners earns, beside a heuristic."""

from matplotlib.figure import Figure

from halfseen.figures import BLUE, INK, SOFT
from pictures.guide_pages import names_after
from pictures.picture import Table, plot, whole
from pictures.style import panel


def _planners() -> Table:
    from halfseen.evaluation.simulation import evaluate_in_world

    names = names_after("another-planner", 0, 1, 2)
    config, scene, rows = names["config"], names["scene"], []
    for name, policy in names["contenders"].items():
        value = evaluate_in_world(policy, [scene], config, episodes=2000, seed=0).value
        rows.append({"policy": name, "value": float(value.value), "standard_error": float(value.standard_error)})
    return rows


def draw_planners(rows: Table) -> Figure:
    """Draw what the page's two policies earn."""
    made, axes = panel(1.5, "mean reward of 2,000 episodes", has_grid=False)
    for place, (row, colour) in enumerate(zip(rows, (BLUE, SOFT), strict=True)):
        axes.barh(place, row["value"], 0.55, color=colour)
        axes.errorbar(row["value"], place, xerr=1.96 * row["standard_error"], color=INK, capsize=3.0)
        axes.text(row["value"] + 2.2 * row["standard_error"], place, f"  {row['value']:.1f}", va="center")
    names = [row["policy"].replace(", counting", ",\ncounting") for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set_xlim(0.0, 1.4 * max(row["value"] for row in rows))
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    return made


TWO_PLANNERS = plot("two-planners", draw_planners, whole("two-planners.csv", _planners))
