"""Regression on times that may be cut, simulated: how far from the truth each way of treating the cut rows is.

Read down: `settings` (what is simulated) → `methods` (who estimates the median) → `comparison` (repetitions and errors)
→ `words` (table and sentence) → `figures` (their parts) → `layouts` → `command` (what the scripts share).
"""
