"""A fuzzing campaign: broken inputs and command lines, each of which is refused in one line or answered rightly.

A case is drawn from a seed and its number: a small valid input of `corpus`, broken once or twice by a mutator, and a
command line that reads it. Long-lived worker processes run the command line in-process; one that hangs, dies or takes
too much memory is replaced. `oracle` judges what came of it. ``python -m fuzz --help``, from the folder of tests.
"""
