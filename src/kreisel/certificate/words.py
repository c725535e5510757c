"""The words of a certificate, in English and German; they stand in words.toml."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files

LANGUAGES = ("en", "de")


@cache
def words(language: str) -> dict[str, str]:
    """Return the words in a language, one of `LANGUAGES`."""
    text = files("kreisel.certificate").joinpath("words.toml").read_text(encoding="utf-8")
    return dict(tomllib.loads(text)[language])


def number(text: str, language: str) -> str:
    """Return a number as the language writes it: in German with a decimal comma."""
    return text.replace(".", ",") if language == "de" else text
