"""The journal: what a recorder has written so far, line by line, and what a reader makes of it at any moment.

Read down: `lines` (an event each, chained by checksums) → `parts` (one file after another) → `values`, `clock` (what a
line takes) → `state` (what is known of the folder and of the trajectory in progress) → `durability`, `writer` (one
process writes) → `tables` (from events to the tables of `Logs`).
"""
