"""Drafts of mappings: taken literally, they do not make a wrong log without a word."""

STOPS = """run,tool,t,score,status
1,a,1,0.5,
1,b,2,1.5,{one}
2,a,3,2.5,{other}
"""


def test_an_empty_cell_is_no_finish_where_each_trajectory_has_an_ending(draft):
    told = '# guess: endings that are not cuts, "" for an empty cell'
    draft(STOPS.format(one="SUCCEEDED", other="PREEMPTED"), f'finished = ["SUCCEEDED"]  {told}')
    draft(STOPS.format(one="grün", other="rot"), f"finished = []  {told}")
    draft(STOPS.format(one="rot", other=""), f'finished = [""]  {told}')
