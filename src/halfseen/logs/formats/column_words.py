"""Words in the names of columns and events, and what such columns and events usually carry."""

import re

BEGIN_LIKE = re.compile(r"beg[ia]n|start|anfang|début|inicio|inizio|^(von|from)$", re.IGNORECASE)
"""Pattern of column names of begin times, in German, English, French, Spanish or Italian."""
LIKE = {
    "clock.field": r"zeit|time|stamp|date|datum|uhr|elapsed|clock|ende?_|end$|dauer|^t$|(^|_)(ms|us|ns|s|min)$"
    r"|(^|_)days?$|heure|horodat|fecha|hora|^ora$|^data",
    "clock.begin": BEGIN_LIKE.pattern,
    "trajectory": r"lauf|run|traj|episode|auftrag|order|job|batch|charge|cycle|zyklus|trial|essai|ciclo|lote|lotto",
    "topic": r"ereignis|event|typ|meldung|message|topic|kind|signal|tag|évén|mensaje|messaggio",
    "action": r"a[kc]tion|griff|greif|grip|tool|werkzeug|decision|choice|prise|pince|outil|acción|azione|pinza",
    "object": r"obje[kc]?t|teil|part|item|pièce|pieza|pezzo",
    "probability": r"prob|wahrsch|propens|^p$",
    "reward": r"reward|belohn|ertrag|worth|wert|value|score|punkt|profit|gewinn|récomp|valeur|valor",
    "ending": r"ende?$|ending|ergebnis|outcome|result|abbruch|schluss|stop|cause|grund|ursache|fault|fehler|stör|status"
    r"|reason|drop_?out|withdr"
    r"|^fine?$|résult|risult|causa|motif|arrêt|terminat|truncat",
}
"""Patterns of column names for each key, in order of assignment: German, English, French, Spanish, Italian."""
EVENTS_LIKE = {
    "trajectory": r"^(start|begin|anfang|début|inicio|inizio)|[^a-z](start(ed)?|begin|begun|anfang)$",
    "ending": r"^end|[^a-z]end(e|ed)?$|^fine?$|stop|finish|fertig|abbruch|not-?halt|arrêt|parada|arresto",
    "reward": r"reward|ertrag|place|ablage|abgelegt|result|ergebnis|drop|success|^n?ok$|^(n\.?)?i\.?o\.?$"
    r"|dépo|depó|depos|résult",
    "action": r"griff|greif|pick|gras?p|grip|a[kc]tion|prise|agarre|presa|acción|azione",
}
FLAGS_LIKE = {
    "ending.finished": re.compile(r"terminat|is_terminal|(^|_)done$", re.IGNORECASE),
    "ending.cut": re.compile(r"truncat|time_?out|time_?limit|^is_last$", re.IGNORECASE),
}
"""Patterns of columns with ending flags in the row of the action."""
END_TIME_LIKE = re.compile(r"(^|[^a-z])(end(e|ed)?|bis|until|fin(e|ished)?|done|stop(ped)?)([^a-z]|$)", re.IGNORECASE)
"""Pattern of columns with the end time of a stage."""
KNOWN_LATER = re.compile(f"{LIKE['ending']}|{END_TIME_LIKE.pattern}|^is_(first|last)$", re.IGNORECASE)
"""Pattern of columns that are no covariates because they are known only after the action."""
FINISHED_LIKE = re.compile(r"fertig|finish|done|complet|success|^ok$|^ende?$|termin|réussi", re.IGNORECASE)
"""Pattern of events and endings that are no cut."""
WIDE_LIKE = {
    "action": r"a|arm|d|dos[ei]s?|trt|treat\w*|tx|rx|therap\w*|drug|behandlung|traitement|tratamiento|trattamento",
    "trajectory": rf"{LIKE['trajectory']}|^id$|patient|subject",
    "reward": r"y|r|outcome|utility|response",
}
"""Further patterns in tables of one row a trajectory: of whole names, that of a trajectory of parts."""
