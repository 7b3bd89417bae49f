"""Made-up regrets on small tables, for the tests of what is tabulated, drawn and written from them."""

from halfseen.study.regret_table import regret_table

BASELINES = {
    "optimum": [4.0, 6.0],
    "finish": [-9.0, -9.0],
    "regrets": {
        "greedy": [3.0, 5.0],
        "history": [3.0, 4.0],
        "greedy-penalty": [2.0, 3.0],
        "history-penalty": [2.0, 2.5],
    },
}


def piece(repetition, end=1.0):
    noise = 0.1 * repetition
    learned = [
        {
            "policy": "cql",
            "num_paths": size,
            "cut_share": share,
            "regrets": [end * 100 / size + noise, 2.0 * share + noise],
        }
        for size in (50, 200)
        for share in (0.0, 0.5)
    ]
    planned = [{"policy": f"pomdp-{h}", "regrets": [0.5 / h, 0.7 / h + noise]} for h in (1, 2)]
    return {"repetition": repetition, "rows": planned + learned}


def example_regret(end=1.0):
    return regret_table(BASELINES, [piece(k, end) for k in range(3)])
