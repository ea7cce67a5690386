import pytest

from lerobot_gloves.perturbations import PERTURBATIONS
from lerobot_gloves.recording.sources import SOURCES, agent_task, source_of


@pytest.mark.parametrize("source", SOURCES[1:])
def test_an_agents_task_string_says_who_proposed_and_how_much(source):
    assert source_of(agent_task(source, 16)) == source_of(agent_task(source, 16, succeeded=True)) == (source, 16)


@pytest.mark.parametrize("task", ["0 2 3", "", "none", "noised", "the agent: noised, chunks of 10", "agent: none"])
def test_any_other_task_string_is_the_experts(task):
    assert source_of(task) == ("expert", 1)


def test_the_papers_perturbations_are_sources():
    assert list(SOURCES) == [
        "expert",
        "none",
        *list(PERTURBATIONS)[:4],
    ]  # the order is that of the trained networks' labels


def test_what_is_no_source_is_refused_with_the_valid_ones():
    for call in (lambda: agent_task("noisy", 10), lambda: source_of("agent: noisy, chunks of 10")):
        with pytest.raises(ValueError, match=r"unknown source 'noisy' .* choose from none, noised, laggy, slow, shift"):
            call()
    with pytest.raises(ValueError, match="expert"):
        agent_task("expert", 10)
    with pytest.raises(ValueError, match="0 actions, but must have at least 1"):
        agent_task("slow", 0)
