"""A problem of one's own, given as arrays and solved exactly: the tiger behind one of two doors.

python examples/tiger.py
"""

from halfseen.planners import DiscreteSolution, solve_discrete

NAMES = ("listen", "open left", "open right")
RIGHT, DISCOUNT = 0.85, 0.95

STAY, ANEW = [[1.0, 0.0], [0.0, 1.0]], [[0.5, 0.5], [0.5, 0.5]]
TRANSITION = [STAY, ANEW, ANEW]
"""P(tiger's side after | its side, action): opening a door starts again."""
OBSERVATION = [[[RIGHT, 1.0 - RIGHT], [1.0 - RIGHT, RIGHT]], ANEW, ANEW]
"""P(growl on the left, on the right | action, tiger's side after it)."""
REWARD = [[-1.0, -1.0], [-100.0, 10.0], [10.0, -100.0]]


def solved(num_actions: int) -> DiscreteSolution:
    """The optimum of so many actions, nothing being known at first."""
    return solve_discrete(TRANSITION, OBSERVATION, REWARD, DISCOUNT, num_actions, [0.5, 0.5])


def main() -> None:
    """Print the value of some horizons, and what to do after each number of growls on the left."""
    for num_actions in range(1, 5):
        found = solved(num_actions)
        print(f"horizon {num_actions}: worth {found.value:.4f}, first {NAMES[found.action]}")
    found = solved(4)
    for num_growls in range(4):
        odds = (RIGHT / (1.0 - RIGHT)) ** num_growls
        left = odds / (1.0 + odds)
        action = NAMES[found.action_of([left, 1.0 - left], 4 - num_growls)]
        print(f"growls on the left: {num_growls}, tiger there with probability {left:.3f}: {action}")


if __name__ == "__main__":
    main()
