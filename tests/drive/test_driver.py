"""Scripted drivers against what is said of them, and their way to the robot against the page's."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_gloves.drive.assistance import load_assistance, load_person
from lerobot_gloves.drive.driver import LEAST, MOST, RATE, SKILLS, Driver, Skill
from lerobot_gloves.drive.session import Session
from lerobot_gloves.drive.surrogates import play
from lerobot_gloves.drive.view import view_of
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.builders import save_policy

CONFIG = SlalomEnv(episode_length=40, image_size=64)
VIEW = view_of(CONFIG)
SURE = Skill(reaction=(0.3, 0.0), foresees=1.0, thinks=0.05, misjudges=0.0, slips=0.0)


def at(y: float, x: float = 0.425) -> dict:
    """An observation with the rod's tip there."""
    return {"agent_pos": np.array([x, y, x, y], dtype=np.float32)}


def driver(skill: Skill = SURE, seed: int = 0) -> Driver:
    return Driver("gloves_slalom", VIEW, skill, seed, "0 1 1")


def test_a_key_answers_what_was_seen_a_reaction_time_ago():
    one = driver()
    facing, aside = at(-0.2), at(-0.19, 0.5)  # in front of the first row, once facing the gap and once not
    sent = [one.command(facing) for _ in range(20)] + [one.command(aside) for _ in range(7)]
    # 0.3 s are six steps: at the seventh the rod is seen off its way, and the way to the left is up on the picture.
    assert [stick[:2] for stick in sent[:26]] == [(1.0, 0.0)] * 26
    assert sent[26][1] == 1.0 and one.reaction == pytest.approx(0.3)


@pytest.mark.parametrize("name", SKILLS)
def test_reaction_times_differ_between_episodes_and_keep_to_their_bounds(name):
    times = [driver(SKILLS[name], seed).reaction for seed in range(300)]
    mean, deviation = SKILLS[name].reaction
    assert LEAST <= min(times) < max(times) <= MOST
    assert np.mean(times) == pytest.approx(mean, abs=0.02) and np.std(times) == pytest.approx(deviation, abs=0.015)


def test_a_slip_is_a_neighbouring_key_and_comes_as_often_as_is_said():
    steps = 20_000
    one = driver(Skill((0.3, 0.0), 1.0, 0.05, 0.0, slips=0.5))
    sent = [one.command(at(0.34))[:2] for _ in range(steps)]  # past all rows: to the right
    wrong = {stick for stick in sent if stick != (1.0, 0.0)}
    assert {tuple(round(part, 3) for part in stick) for stick in wrong} == {(0.707, 0.707), (0.707, -0.707)}
    begun = sum(after != (1.0, 0.0) == before for before, after in itertools.pairwise(sent))
    assert begun == pytest.approx(0.5 * steps / RATE, rel=0.2)


def test_only_eight_directions_are_pressed():
    one, rng = driver(SKILLS["beginner"]), np.random.default_rng(0)
    for _ in range(500):
        x, y, *_ = one.command(at(rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.7)))
        if x or y:
            eighths = math.atan2(y, x) / (math.pi / 4)
            assert math.hypot(x, y) == pytest.approx(1.0) and eighths == pytest.approx(round(eighths), abs=1e-6)


def test_many_episodes_at_once_are_those_of_the_page(tmp_path):
    """What is executed is, step by step, what a page's session executes of the same keys."""
    options = {"adapter": str(save_policy(tmp_path / "flow", "gloves_expert_flow", seed=7)), "method": "feeg"}
    skill, seeds = SKILLS["ordinary"], [1, 2]
    with environments(CONFIG, 2) as env:
        executed = noted(env)
        drives = play(env, load_person(CONFIG, options, "cpu"), CONFIG.type, VIEW, skill, seeds)
    assert [one.steps for one in drives] == [40, 40] and all(one.crept == 0 for one in drives)
    assert all(0 < one.changed == one.commands and one.moved > 0 for one in drives)
    with environments(CONFIG, 1) as env:
        alone = noted(env)
        assistance = load_assistance(CONFIG, options, VIEW.faults, "cpu")
        session = Session(env, VIEW, assistance, seeds[0], lambda: 0.0)
        one = Driver(CONFIG.type, VIEW, skill, seeds[0], session.tick().about["task"])
        for _ in range(40):
            session.stick.move(*one.command({key: value[0] for key, value in session._observation.items()}))
            session.tick()
    np.testing.assert_allclose([step[0] for step in executed], [step[0] for step in alone], rtol=1e-4, atol=1e-7)


def noted(env) -> list:
    """What an environment will be given."""
    given, step = [], env.step

    def stepped(actions):
        given.append(np.array(actions))
        return step(actions)

    env.step = stepped
    return given


def test_who_waits_stands_still_and_is_no_command(tmp_path, monkeypatch):
    options = {"adapter": str(save_policy(tmp_path / "flow", "gloves_expert_flow", seed=7)), "method": "feeg"}
    waits = SimpleNamespace(command=lambda seen: (0.0, 0.0, 0.0, 0.0), reaction=0.3)
    monkeypatch.setattr("lerobot_gloves.drive.surrogates.Driver", lambda *_: waits)
    with environments(CONFIG, 1) as env:
        executed = noted(env)
        (one,) = play(env, load_person(CONFIG, options, "cpu"), CONFIG.type, VIEW, SURE, [1])
    assert not np.any(executed) and (one.commands, one.changed, one.crept, one.failure) == (0, 0, 0, "timeout")
