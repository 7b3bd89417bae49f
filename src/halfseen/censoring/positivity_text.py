"""The positivity report in words: the verdict first, then what it rests on."""

from halfseen.censoring.diagnostics import FEWEST_EFFECTIVE
from halfseen.censoring.positivity_facts import PositivityFacts, Truncation, WeightedTrajectory


def text(facts: PositivityFacts) -> str:
    """Write a few plain sentences and a table of truncations."""
    sentences = [verdict(facts), remedy(facts)]
    if facts.num_finished:
        sentences += [_size(facts), _heaviest(facts.heaviest)]
    sentences += [_until(facts), _mean_weight(facts)]
    return "\n".join([sentence for sentence in sentences if sentence] + _table(facts))


def verdict(facts: PositivityFacts) -> str:
    """Say in one sentence whether the weights can be trusted."""
    size, tail = facts.overall.effective_sample_size, facts.tail
    if facts.num_finished == 0:
        every = (
            "the only trajectory was"
            if facts.num_trajectories == 1
            else f"all {facts.num_trajectories} trajectories were"
        )
        return f"Nothing to weigh: {every} cut."
    if facts.has_gap:
        first = min(facts.unidentified, key=lambda trajectory: trajectory.time_s)
        return (
            f"Not identified: {_number(len(facts.unidentified))} finished where no trajectory is left "
            f"uncut (Ĝ = 0), first trajectory {first.trajectory} at {first.time_s:.4g} s."
        )
    finishes = "1 finish has" if facts.num_finished == 1 else f"{facts.num_finished} finishes have"
    finishes += f" an effective sample size of {size:.1f}"
    if size < FEWEST_EFFECTIVE:
        return f"Too little: {finishes}."
    if facts.is_thin:
        return (
            f"Thin at the end: {finishes}, but the last "
            f"{tail.num_seen}, from {facts.tail_from_s:.4g} s on, only {tail.effective_sample_size:.1f}."
        )
    if facts.is_off:
        return f"Incomplete: {finishes}, but stand for {facts.mean_weight:.0%} of the trajectories, not for all."
    return f"Sound: {finishes}."


def remedy(facts: PositivityFacts) -> str:
    """Say what to do about it; empty where nothing needs to be done."""
    if facts.num_finished == 0:
        return "Record until some trajectories finish, or shorten the horizon so that reaching it counts as finished."
    if facts.has_gap:
        return (
            f"Shorten the horizon so that it ends before {facts.identified_until_s:.4g} s, fit the model to "
            "trajectories that were watched longer, or truncate the weights knowingly with truncate_at=…."
        )
    size = facts.overall.effective_sample_size
    if size >= FEWEST_EFFECTIVE and not facts.is_thin:
        return _completion(facts) if facts.is_off else ""
    if size > 0.9 * facts.num_finished:
        return "Record more trajectories; the weights are not what makes them few."
    return (
        f"Record more trajectories, shorten the horizon to before {facts.tail_from_s:.4g} s, or truncate the weights "
        "knowingly with truncate_at=…; the table shows what that changes."
    )


def _completion(facts: PositivityFacts) -> str:
    if facts.mean_weight > 1.0:
        return "The model takes cuts for likelier than they were; try another."
    return (
        f"Either the rest finish after {facts.identified_until_s:.4g} s: restrict times to an earlier one (a "
        "trajectory that outlives it then counts as seen). Or the model takes cuts for rarer than they were: try "
        "another."
    )


def _size(facts: PositivityFacts) -> str:
    overall, tail = facts.overall, facts.tail
    if facts.has_gap:
        size = overall.effective_sample_size
        return f"The {overall.num_seen} that have a weight have an effective sample size of {size:.1f}."
    truncated = f"; {overall.share_truncated:.1%} of the weight is truncated" if facts.truncate_at is not None else ""
    return (
        f"{facts.num_finished} of {_number(facts.num_trajectories)} finished; the last quarter of the "
        f"finishes, {tail.num_seen} from {facts.tail_from_s:.4g} s on, has an effective sample size of "
        f"{tail.effective_sample_size:.1f}{truncated}."
    )


def _heaviest(heaviest: tuple[WeightedTrajectory, ...]) -> str:
    named = ", ".join(f"{heavy.weight:.3g} (trajectory {heavy.trajectory}, {heavy.time_s:.4g} s)" for heavy in heaviest)
    return f"Largest weights: {named}." if heaviest else ""


def _until(facts: PositivityFacts) -> str:
    known = f"Nothing is known of finishes after {facts.identified_until_s:.4g} s"
    if facts.num_extrapolated:
        return f"{known}; {_number(facts.num_extrapolated)} finished later, on the model's word alone."
    reason = "the last trajectory was cut then" if facts.ends_in_cut else "the last trajectory finished then"
    return f"{known}." if facts.unidentified else f"{known}: {reason}."


def _mean_weight(facts: PositivityFacts) -> str:
    if facts.num_finished == 0 or facts.has_gap:
        return ""
    missing = 1.0 - facts.mean_weight
    if facts.ends_in_cut and missing > 0.0005 and facts.truncate_at is None and not facts.has_gap:
        return (
            f"The mean weight is {facts.mean_weight:.3f}, so some {missing:.1%} of trajectories finish later than that."
        )
    return f"The mean weight is {facts.mean_weight:.3f}; it is near 1 where the model is right and all can be seen."


def _table(facts: PositivityFacts) -> list[str]:
    if not facts.truncations:
        return []
    head = ("weights up to", f"mean {facts.quantity}", "effective sample size", "weight taken away")
    rows = [head, *(_cells(row) for row in facts.truncations)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    return ["", *("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)]


def _cells(row: Truncation) -> tuple[str, str, str, str]:
    bound = "no bound" if row.truncate_at is None else f"{row.truncate_at:.3g}"
    return (
        bound,
        f"{row.mean:.4g}",
        f"{row.effective_sample_size:.1f}",
        "no end" if row.share_removed is None else f"{row.share_removed:.1%}",
    )


def _number(count: int) -> str:
    return f"{count} {'trajectory' if count == 1 else 'trajectories'}"
