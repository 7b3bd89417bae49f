"""Several robots at one table (design, §9): who decides when, knowing what the others are at."""
