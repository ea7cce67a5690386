from dataclasses import dataclass

import pytest

from lerobot_gloves.editors import FEEG, FPAS
from lerobot_gloves.scores import SCORES, ReverseScore
from lerobot_gloves.specification import name_of, parse, parse_all, parts_of, specification

EDITORS = {"fpas": FPAS, "feeg": FEEG}


@dataclass(frozen=True)
class Bare:
    """No options."""


def test_a_name_alone_has_the_defaults_and_options_are_read_as_their_types():
    assert parse("feeg", EDITORS, "method") == FEEG()
    assert parse("feeg:", EDITORS, "method") == FEEG()
    editor = parse("feeg:start=0.25,steps=7", EDITORS, "method")
    assert editor == FEEG(start=0.25, steps=7, align=FEEG().align)
    assert type(editor.steps) is int and type(parse("feeg:start=1", EDITORS, "method").start) is float
    assert parse("fpas:sigma=1e-3", EDITORS, "method").sigma == 0.001


@pytest.mark.parametrize(
    "instance", [FEEG(), FEEG(start=0.1, align=1e-17), FPAS(sigma=1 / 3, iterations=2), ReverseScore(steps=5), Bare()]
)
def test_what_is_written_is_read_back_as_the_same(instance):
    choices = {**EDITORS, **SCORES, "bare": Bare}
    assert parse(specification(instance, choices), choices, "method") == instance


def test_every_option_is_written_out():
    assert specification(ReverseScore(), SCORES) == "reverse:steps=1"
    assert specification(Bare(), {"bare": Bare}) == "bare"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fegg", "unknown method 'fegg': choose from feeg, fpas"),
        ("", "unknown method '': choose from feeg, fpas"),
        ("feeg:begin=0.1", "method 'feeg' has no option 'begin': choose from start, steps, align"),
        ("feeg:steps=2.5", "method 'feeg': steps='2.5' is not a number of type int"),
        ("feeg:start", "method 'feeg': start='' is not a number of type float"),
        ("feeg:start=2", "FEEG: start is 2.0, but must lie in [0, 1]"),
        ("feeg:align=-1", "FEEG: align is -1.0, but must not be negative"),
        ("feeg:align=nan", "method 'feeg': align='nan' is not finite"),
        ("fpas:sigma=1e400", "method 'fpas': sigma='1e400' is not finite"),
        ("feeg:start=0.1,start=0.9", "method 'feeg': start is there twice"),
    ],
)
def test_a_wrong_word_is_named_with_the_right_ones(text, message):
    with pytest.raises(ValueError) as error:
        parse(text, EDITORS, "method")
    assert str(error.value) == message


def test_an_option_of_nothing_says_so():
    with pytest.raises(ValueError, match="has no option 'a': choose from none"):
        parse("bare:a=1", {"bare": Bare}, "score")


@pytest.mark.parametrize(
    ("text", "parts", "name"),
    [
        ("feeg:start=0.5", ["feeg:start=0.5"], "feeg"),
        ("none", ["none"], "none"),
        ("noised:sigma=1e+3+laggy:p=0.2", ["noised:sigma=1e+3", "laggy:p=0.2"], "noised+laggy"),
        ("noised+", ["noised", ""], "noised+"),
    ],
)
def test_a_compound_has_parts_and_their_names(text, parts, name):
    assert parts_of(text) == parts
    assert name_of(text) == name


def test_several_are_read_one_by_one():
    assert parse_all("reverse:steps=5+reverse", SCORES, "score") == (ReverseScore(steps=5), ReverseScore())
    assert parse_all("reverse", SCORES, "score") == (ReverseScore(),)
    with pytest.raises(ValueError, match="unknown score 'corection': choose from"):
        parse_all("reverse:steps=5+corection", SCORES, "score")
