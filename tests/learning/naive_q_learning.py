"""Equation (3) once more, with loops over trajectories and blocks, and dense solvers: slow, and independent."""

import numpy as np


def naive_ridge(features, target, weight, reg, num_trajectories, scale=None):
    """Coefficients, offset first, of λ‖β‖² + (1/n) Σ w (y − α − xᵀβ)² with x scaled to unit weighted variance."""
    num_features = features.shape[1]
    if weight.sum() == 0:
        return np.zeros(num_features + 1)
    mean = np.average(features, axis=0, weights=weight)
    centred = features - mean
    if scale is None:
        scale = naive_scale(features, weight)
    used = centred[:, scale > 0] / scale[scale > 0]
    offset_free = target - np.average(target, weights=weight)
    root = np.sqrt(weight)[:, None]
    design = np.vstack([used * root, np.sqrt(reg * num_trajectories) * np.eye(used.shape[1])])
    answer = np.concatenate([offset_free * root[:, 0], np.zeros(used.shape[1])])
    slopes = np.zeros(num_features)
    slopes[scale > 0] = np.linalg.lstsq(design, answer, rcond=1e-7)[0] / scale[scale > 0]
    return np.concatenate([[np.average(target, weights=weight) - slopes @ mean], slopes])


def naive_scale(features, weight):
    if weight.sum() == 0:
        return np.zeros(features.shape[1])
    spread = np.sqrt(np.average((features - np.average(features, axis=0, weights=weight)) ** 2, axis=0, weights=weight))
    return np.where(spread > 1e-9, spread, 0.0)


def naive_choice(features, target, weight, fold, regs, num_trajectories, num_folds):
    """λ with the smallest held-out weighted error, by a loop over λ and folds."""
    scale = naive_scale(features, weight)
    errors = []
    for reg in regs:
        error = 0.0
        for held in range(num_folds):
            train = np.where(fold == held, 0.0, weight)
            beta = naive_ridge(features, target, train, reg, num_trajectories * (num_folds - 1) / num_folds, scale)
            rest = target - beta[0] - features @ beta[1:]
            error += np.sum(np.where(fold == held, weight, 0.0) * rest**2)
        errors.append(error)
    return max(reg for reg, error in zip(regs, errors, strict=True) if error <= min(errors) * (1.0 + 1e-9))


def naive_q(beta, features, blocks):
    """Q of every action of one stage of one trajectory."""
    return np.array([beta[k][0] + features[a] @ beta[k][1:] for a, k in enumerate(blocks)])


def _best(beta, log, blocks, trajectory, stage, policy=None):
    q = naive_q(beta, log.features[trajectory, stage], blocks)
    if policy is not None:
        return sum(policy[trajectory, stage, a] * q[a] for a in range(len(blocks)))
    return max(q[a] for a in range(len(blocks)) if log.is_possible[trajectory, stage, a])


def _fit(rows, blocks, num_blocks, log, centre, reg, num_folds):
    """One regression of (trajectory, stage, target) triples, shrunk towards `centre`."""
    num_trajectories = len(log.action)
    beta = []
    for block in range(num_blocks):
        mine = [row for row in rows if blocks[log.action[row[0], row[1]]] == block]
        x = np.array([log.features[i, t, log.action[i, t]] for i, t, _ in mine]).reshape(-1, log.features.shape[-1])
        w = np.array([log.weight[i, t] for i, t, _ in mine])
        y = np.array([target for *_, target in mine]) - centre[block][0] - x @ centre[block][1:]
        chosen = reg
        if not np.isscalar(reg):
            chosen = naive_choice(x, y, w, np.array([log.fold[i] for i, *_ in mine]), reg, num_trajectories, num_folds)
        beta.append(centre[block] + naive_ridge(x, y, w, chosen, num_trajectories))
    return np.array(beta)


def naive_backward(log, blocks, num_blocks, reg, stages, end_action=None, num_folds=1, policy=None):
    """Coefficients of Q_1 … Q_T (separate), or of one to T steps to go (pooled)."""
    num_trajectories, horizon = log.action.shape
    completed = [(i, t) for i in range(num_trajectories) for t in range(horizon) if log.weight[i, t] > 0]
    zero = np.zeros((num_blocks, log.features.shape[-1] + 1))

    def target(i, t, value_of_successor):
        return log.reward[i, t] + (0.0 if log.is_last[i, t] or t == horizon - 1 else value_of_successor(i, t + 1))

    if stages == "separate":
        fitted = {}
        for t in reversed(range(horizon)):
            after = fitted.get(t + 1)
            rows = [
                (i, s, target(i, s, lambda i, u, after=after: _best(after, log, blocks, i, u, policy)))
                for i, s in completed
                if s == t
            ]
            fitted[t] = _fit(rows, blocks, num_blocks, log, zero, reg, num_folds)
        return np.array([fitted[t] for t in range(horizon)])

    centre, value = zero, lambda i, u: 0.0
    if end_action is not None:
        ended = _fit([(i, t, log.reward[i, t]) for i, t in completed], blocks, num_blocks, log, zero, reg, num_folds)
        centre = np.array([ended[blocks[end_action]]] * num_blocks)

        def value(i, u):
            return naive_q(ended, log.features[i, u], blocks)[end_action]

    fitted = []
    for steps_to_go in range(1, horizon + 1):
        rows = [
            (i, t, target(i, t, value))
            for i, t in completed
            if steps_to_go == 1 or t < horizon - 1 or (end_action is not None and log.action[i, t] == end_action)
        ]
        centre = _fit(rows, blocks, num_blocks, log, centre, reg, num_folds)
        fitted.append(centre)

        def value(i, u, beta=centre):
            return _best(beta, log, blocks, i, u, policy)

    return np.array(fitted)
