"""A tokenizer of the few words that the tests' tasks are made of."""

from collections.abc import Sequence
from typing import Any

WORDS = ["<pad>", "<unk>", "move", "left", "go", "right"]
SIZE = 16
"""Size of the vocabularies, the marks of the models among them."""


def tokenizer(marks: Sequence[str] = ()) -> Any:
    """Of these words and, behind them, a model's own marks, each of which is one token."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    known = {word: number for number, word in enumerate([*WORDS, *marks])}
    words = Tokenizer(models.WordLevel(known, "<unk>"))
    words.pre_tokenizer = pre_tokenizers.Whitespace()
    words.add_special_tokens(list(marks))
    return PreTrainedTokenizerFast(tokenizer_object=words, pad_token="<pad>", unk_token="<unk>")
