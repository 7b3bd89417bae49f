"""Censored support vector machines (paper, eqs. 1 and 2)."""
