"""What is drawn and written for people: shared by the report of a log and by the study.

Read it down: `numbers` and `sentences` (how numbers and claims are written) → `palette` → `drawing` (figures as bytes)
→ `axes` (what several figures draw alike) → `html` (a page from a template).
"""
