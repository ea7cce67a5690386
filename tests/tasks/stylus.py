"""Moving Keypad's stylus by hand."""

import numpy as np

# The keypad as documented: rows along x, columns along y, 5 cm apart, around (0.5, 0).
BUTTONS = [(0.45 + 0.05 * row, -0.05 + 0.05 * column) for row in range(3) for column in range(3)]
ABOVE, DEEP = 0.07, 0.031
OVER = {"is_success": False, "failure": ""}


def moves(start, *points, step=0.003):
    """Actions that lead the set-point from a point (3,) through others, `step` metres or less an axis at a time."""
    actions, here = [], np.array(start, dtype=float)
    for point in points:
        way = np.array(point) - here
        n = max(1, int(np.ceil(np.abs(way).max() / step - 1e-9)))
        actions += [way / n] * n
        here += way
    return actions


def above(button, height=ABOVE, dx=0.0, dy=0.0):
    x, y = BUTTONS[button]
    return x + dx, y + dy, height


def press(button, **options):
    """Points that press a button and rise again."""
    return [above(button), above(button, DEEP, **options), above(button)]


def play(env, *points, step=0.003, **reset):
    """Play until the set-point has passed the points or the episode has ended.

    Returns:
        The observations with the first, and the last step's outcome.
    """
    observation, info = env.reset(**reset)
    assert info == OVER
    return go(env, observation, *points, step=step)


def go(env, observation, *points, step=0.003):
    """Play on from an observation; the same results."""
    observations = [observation]
    for action in moves(observation["agent_pos"][3:6], *points, step=step):
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        if terminated or truncated:
            break
        assert (reward, info) == (0.0, OVER)
    return observations, (reward, terminated, truncated, info)
