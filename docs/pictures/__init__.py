"""The pictures of README and docs: what each is drawn from, how, and whether it is stale.

`make pictures` draws all of them, `make pictures ONLY=name` one, and `make pictures ONLY=name REMAKE=1` computes its
numbers first. What takes long to compute is kept as a small table in `numbers/`, which the picture is drawn from; a
slow test computes a part of the table again.

Read down: `picture` (what a picture is) → `likeness` (whether two are alike) → a file for each kind of picture →
`registry` (all of them).
"""
