"""How a release is built and checked: ``make release``.

`notes` (the changelog's entry of a version) → `archives` (what sdist, wheel and pages hold, and no more) →
`every_verb`, `walk` (the wheel in a bare environment) → `bill` (what it stands on, as CycloneDX).
"""
